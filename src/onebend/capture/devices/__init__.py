"""Cameras and force sensors, one module a kind of wire."""
