"""The force log: read, checked, cleaned, and where in it the beam is touched."""
