"""The model of the marker-space fit: its parameters, what it predicts of the tags, and its derivatives."""
