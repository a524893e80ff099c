"""A robot log in a sqlite3 database read page by page, as far as its pages are there."""

from __future__ import annotations

import re
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager
from os import truncate
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory

from onebend.recording.bags.items import BrokenOffError, Channel, Item

PLAIN_TABLE = re.compile(r"\s*CREATE\s+TABLE\b", re.IGNORECASE)
COLUMNS = "SELECT * FROM pragma_table_xinfo(?)"
COMPUTED = {2, 3}  # what the last of these columns says of one that is computed
SQLITE_MAGIC = b"SQLite format 3\0"


def scan_sqlite(path: Path) -> Iterator[Item]:
    """Topics, then messages in the order they were written, up to the first page that is not there as a whole."""
    try:
        with (
            whole_pages(path) as file,
            closing(sqlite3.connect(f"{file.resolve().as_uri()}?immutable=1", uri=True)) as base,
        ):
            refuse_programs(base)
            base.execute("PRAGMA writable_schema=ON")  # else a file shorter than it says is refused as a whole
            tables = {name for (name,) in base.execute("SELECT name FROM sqlite_master")}
            texts = {}
            if "message_definitions" in tables:
                rows = base.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
                texts = {kind: (text, encoding.endswith("idl")) for kind, encoding, text in rows}
            channels = {}
            for key, name, kind, encoding in base.execute("SELECT id, name, type, serialization_format FROM topics"):
                if not all(isinstance(text, str) for text in (name, kind, encoding)):
                    raise BrokenOffError("a topic without a name, a type or a packing")
                channels[key] = Channel(name, kind, encoding, *texts.get(kind, ("", False)))
                yield channels[key]
            for key, received, data in base.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY rowid"):
                if key in channels:
                    check_message(received, data)
                    yield channels[key], received, data
    except sqlite3.Error as wrong:
        raise BrokenOffError(lacking(path) or str(wrong)) from None
    if lack := lacking(path):
        raise BrokenOffError(lack)


def refuse_programs(base: sqlite3.Connection) -> None:
    """Raise where what a recorder keeps in tables is computed instead: a view may go on for ever, a column be huge.

    Raises:
        BrokenOffError: a name of a recorder's table is a view or a virtual table, or a column of it is computed.
    """
    base.execute("PRAGMA trusted_schema=OFF")
    for kind, name, text in base.execute("SELECT type, name, sql FROM sqlite_master LIMIT 1000"):
        plain = kind == "index" or (kind == "table" and PLAIN_TABLE.match(text or ""))
        if not plain or (kind == "table" and COMPUTED & {row[6] for row in base.execute(COLUMNS, (name,))}):
            raise BrokenOffError(f"its {kind} {str(name)[:60]!r} is no table of a recorder")


def check_message(received: object, data: object) -> None:
    """Raise `BrokenOffError` where a database's row is no message: it may hold anything in any column."""
    if not isinstance(received, int) or not isinstance(data, bytes):
        raise BrokenOffError("a row of its messages has no time, or no bytes")


def check_database(path: Path) -> None:
    """Raise `BrokenOffError` where the file is a database that computes its messages, or cannot be read as one."""
    with path.open("rb") as stream:
        if stream.read(len(SQLITE_MAGIC)) != SQLITE_MAGIC:
            return
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?immutable=1", uri=True)) as base:
            refuse_programs(base)
    except sqlite3.Error:
        return  # its reader says so


@contextmanager
def whole_pages(path: Path) -> Iterator[Path]:
    """The database, or a copy without its last page where that is cut: its reader would take what lacks for zeros."""
    size, page = path.stat().st_size, sqlite_pages(path)[0]
    if page == 0 or size % page == 0:
        yield path
        return
    with TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copyfile(path, copy)
        truncate(copy, size - size % page)
        yield copy


def lacking(path: Path) -> str:
    """What a database lacks of the length that it says it has, in words; "" for a whole one, or for another file.

    The database's own reader does not always notice."""
    (page, pages), size = sqlite_pages(path), path.stat().st_size
    return f"it ends at byte {size} and says that it has {page * pages}" if size < page * pages else ""


def sqlite_pages(path: Path) -> tuple[int, int]:
    """Bytes of a page and number of pages as a database's head says them; 0 where it does not, or for another file."""
    with path.open("rb") as stream:
        head = stream.read(100)
    if not head.startswith(SQLITE_MAGIC) or len(head) < 100:
        return 0, 0
    page, pages = struct.unpack(">H", head[16:18])[0], struct.unpack(">I", head[28:32])[0]
    known = head[24:28] == head[92:96]  # else an old writer did not keep the number of pages
    return 65536 if page == 1 else page, pages if known else 0
