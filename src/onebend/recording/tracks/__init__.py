"""Tracks of markers and tables of static poses, from any tracker or by hand."""
