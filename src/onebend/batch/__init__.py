"""Many recordings, each learned by itself, on the cores of one machine or of many."""
