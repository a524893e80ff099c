"""A local page for one person: recordings, learning, and the learned beam to bend."""
