"""k(s) from observations, and how good it is."""
