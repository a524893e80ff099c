"""Endings of file names by which films and tables are known."""

from __future__ import annotations

FILMS = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mpg", ".mpeg", ".mts", ".ts", ".wmv")
TABLES = (".csv", ".txt", ".tsv", ".dat", ".log", ".parquet", ".pq")
