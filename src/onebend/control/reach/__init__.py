"""The force that puts a point of the beam on a goal, and which goals can be reached."""
