"""A local page for one person."""
