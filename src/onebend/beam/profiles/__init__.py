"""What varies along the beam: polynomial pieces, families of k(s), cross-sections, and k(s) with its uncertainty."""
