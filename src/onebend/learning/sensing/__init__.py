"""The beam as a force sensor: the force from its shape."""
