"""What the command line shows: progress, tables, and k(s) drawn with block characters."""
