"""Files that are whole or absent: folders published in one step, manifests, locks, single files."""
