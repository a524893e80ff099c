"""The beam in motion: its equation (7), collocation in time, and small vibrations."""
