"""Damping, and k over mass, from a film of the beam swinging freely."""
