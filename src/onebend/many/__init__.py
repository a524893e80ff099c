"""Many recordings: learning one by one on all cores, and statistics of groups of objects."""
