"""Pictures: one function a figure."""
