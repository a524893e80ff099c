"""The closed loop: design with margins, correction by what the camera sees, simulation in full motion."""
