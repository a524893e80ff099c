"""A camera's intrinsic parameters from a film of a calibration board."""
