"""What a run leaves on disk: the learned beam, its tables, the observations, the report."""
