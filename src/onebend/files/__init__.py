"""Files and folders that are complete or absent: folders published in one step, manifests, locks, single files."""
