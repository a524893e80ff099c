"""A beam held at both ends: the pose of s = 1 is given, the wrench there is unknown."""
