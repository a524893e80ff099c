"""What is made for the bench: moulds, clamps, and printed sheets of tags."""
