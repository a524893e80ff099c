"""Tables of Arrow as the content of files."""

from __future__ import annotations

import io

import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq


def as_parquet(table: pa.Table) -> bytes:
    """The content of the table's Parquet file."""
    stream = io.BytesIO()
    pq.write_table(table, stream)
    return stream.getvalue()


def as_csv(table: pa.Table) -> bytes:
    """The content of the table's CSV file."""
    stream = io.BytesIO()
    pc.write_csv(table, stream)
    return stream.getvalue()
