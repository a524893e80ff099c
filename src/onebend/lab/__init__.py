"""The virtual lab: pushes of known beams, with known errors of sensor, camera and mounting."""
