"""Endings of file names by which a folder's film and force log are guessed."""

from __future__ import annotations

FILMS = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mpg", ".mpeg", ".mts", ".ts", ".wmv")
LOGS = (".csv", ".parquet", ".pq")  # text of other endings may be anything
