"""Robot logs (MCAP, ROS 1 bag, sqlite3) read from front to back without their index, up to where a cut or damaged one
breaks off."""

from __future__ import annotations

import bz2
import re
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from io import BytesIO
from os import truncate
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any, BinaryIO, Protocol
from zlib import crc32

from onebend.errors import RecordingError
from onebend.extras import require

# Records of a robot log that is read from front to back: topics, messages, and where it breaks off.


class BrokenOffError(Exception):
    """The file cannot be read beyond a place; the text says which and why."""


@dataclass(frozen=True)
class Channel:
    """One topic as the file declares it."""

    topic: str
    type: str  # "geometry_msgs/msg/Wrench"
    encoding: str  # of the messages: "cdr" or "ros1"
    definition: str  # the message's definition as text; "" where the file has none
    idl: bool  # whether that is IDL, not MSG


Item = tuple[Channel, int, bytes] | Channel  # a message (received at, ns) or the declaration of a topic


# A robot log in a sqlite3 database read page by page, as far as its pages are there.

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


# Everything that onebend takes from the inside of rosbags: its decompressors. All else is its documented interface.
#
# rosbags depends on one zstd and one lz4 library or another, by version of Python; its own names for them spare
# onebend the choice. They unpack whatever they are given, to any size. `bounded_readers` puts others in their place,
# which stop where a chunk, or a whole reading, grows beyond what a film or a log comes to.

VERSIONS = "rosbags>=0.11.9,<0.12"  # as in pyproject.toml: older ones lack names or miss damage
_TABLE = ("rosbags.rosbag2.storage_mcap", "DECOMPRESSORS")
MOST_CHUNK = 2**28  # bytes that one chunk or message may unpack to
MOST_READ, MOST_GAIN = 2**28, 200  # of one reading: bytes whatever the file's size, and times that size
STEP = 2**20  # bytes unpacked at a time


class _Unpacker(Protocol):
    """What zstd, lz4 and bz2 have in common."""

    @property
    def eof(self) -> bool: ...

    @property
    def unused_data(self) -> bytes: ...

    def decompress(self, data: bytes, max_length: int) -> bytes: ...


class ReadingBudget:
    """How much the reading of one file may still unpack."""

    def __init__(self) -> None:
        self.left = float(MOST_READ)

    def renew(self, files: list[Path]) -> None:
        """Begin a reading of the files."""
        self.left = MOST_READ + MOST_GAIN * float(sum(file.stat().st_size for file in files if file.is_file()))

    def take(self, count: int) -> None:
        """Count bytes that were unpacked.

        Raises:
            BrokenOffError: they are more than any film or log comes to.
        """
        self.left -= count
        if self.left < 0.0:
            raise BrokenOffError("it unpacks to far more than a film or a log comes to")


BUDGET = ReadingBudget()


def bounded_readers(files: list[Path]) -> None:
    """Have rosbags unpack no more than one reading of `files` may come to.

    Raises:
        MissingPackageError: rosbags is not installed.
    """
    require(("rosbags",), "ros")
    BUDGET.renew(files)
    table = _decompressors()
    table.update({kind: _bounded_mcap(kind) for kind in ("", "zstd", "lz4")})
    ros1 = getattr(import_module("rosbags.rosbag1.reader"), "decompressors", {})
    ros1.update({kind: lambda data, kind=kind: unpack(kind, data) for kind in ("bz2", "lz4") if kind in ros1})
    reader: Any = import_module("rosbags.rosbag2.reader")
    if not isinstance(reader.zstd, SimpleNamespace):
        reader.zstd = SimpleNamespace(
            decompress=lambda data: unpack("zstd", data), open=_bounded_open(reader.zstd.open)
        )


def _bounded_mcap(kind: str) -> Callable[[bytes, int], bytes]:
    return lambda data, size: unpack(kind, data, min(size, MOST_CHUNK) if size else MOST_CHUNK)


def _bounded_open(opened: Callable[..., Any]) -> Callable[..., Any]:
    """zstd's `open`, whose files count what is read of them."""

    def instead(*arguments: Any) -> Any:
        stream = opened(*arguments)
        read = stream.read

        def counted(size: int = -1) -> bytes:
            data: bytes = read(STEP if size < 0 else min(size, STEP))
            BUDGET.take(len(data))
            return data

        stream.read = counted
        return stream

    return instead


def unpack(kind: str, packed: bytes, most: int = MOST_CHUNK) -> bytes:
    """What `packed` holds, at most `most` bytes; `kind` is "" (not packed), "zstd", "lz4" or "bz2".

    Raises:
        BrokenOffError: it holds more, or the reading has come to more than it may.
    """
    if not kind:
        BUDGET.take(len(packed))
        return packed
    parts, size, data, one = [], 0, packed, _unpacker(kind)
    while True:
        part = one.decompress(data, STEP)
        data = b""
        size += len(part)
        BUDGET.take(len(part))
        if size > most:
            raise BrokenOffError(f"it unpacks to more than the {most} bytes that it may")
        parts.append(part)
        if one.eof and one.unused_data:  # several frames, one after the other
            data, one = one.unused_data, _unpacker(kind)
        elif one.eof:
            return b"".join(parts)
        elif not part:
            raise BrokenOffError("it is cut off")


def _unpacker(kind: str) -> _Unpacker:
    made: _Unpacker
    if kind == "zstd":
        made = import_module(_TABLE[0]).zstd.ZstdDecompressor()
    elif kind == "lz4":
        made = import_module("lz4.frame").LZ4FrameDecompressor()
    else:
        made = bz2.BZ2Decompressor()
    return made


def unpack_zstd(packed: bytes) -> bytes:
    """A message that its recorder packed for itself.

    Raises:
        BrokenOffError: it cannot be unpacked.
    """
    return _unpacked("zstd", packed, 0)


def unpack_mcap_chunk(packed: bytes, compression: str, size: int, checksum: int) -> bytes:
    """The records inside a chunk of an MCAP file; its `size` [bytes] and its CRC-32 (0: none) must hold.

    Raises:
        BrokenOffError: it cannot be unpacked, or is not what was packed.
    """
    content = _unpacked(compression, packed, size)
    if len(content) != size:
        raise BrokenOffError(f"it holds {len(content)} bytes and says that it has {size}")
    if checksum and crc32(content) != checksum:
        raise BrokenOffError("its checksum does not hold")
    return content


def unpack_ros1_chunk(packed: bytes, compression: str) -> bytes:
    """The records inside a chunk of a ROS 1 bag.

    Raises:
        BrokenOffError: it cannot be unpacked.
    """
    if compression not in ("none", "bz2", "lz4"):
        raise BrokenOffError(f"it is packed as {compression!r}, which is not known")
    return _guarded(lambda: unpack("" if compression == "none" else compression, packed))


def _unpacked(compression: str, packed: bytes, size: int) -> bytes:
    if compression not in _decompressors():
        raise BrokenOffError(f"it is packed as {compression!r}, which is not known")
    return _guarded(lambda: unpack(compression, packed, min(size, MOST_CHUNK) if size else MOST_CHUNK))


def _guarded(unpacked: Callable[[], bytes]) -> bytes:
    """What `unpacked` gives; its failure, of whichever library, is the file's."""
    try:
        return unpacked()
    except BrokenOffError:
        raise
    except Exception as wrong:  # zstd, lz4 and bz2 each have an error of their own, or a RuntimeError
        raise BrokenOffError(f"it cannot be unpacked ({wrong})") from None


def _decompressors() -> dict[str, Callable[[bytes, int], bytes]]:
    """By compression ("": none): what unpacks bytes to a size, where that is known.

    Raises:
        RecordingError: the installed rosbags has no such table.
    """
    module, name = _TABLE
    try:
        table: dict[str, Callable[[bytes, int], bytes]] = getattr(import_module(module), name)
    except (ImportError, AttributeError):
        raise RecordingError(
            f"rosbags {version('rosbags')} lacks {module}.{name}, without which a bag cannot be read from front to "
            f"back. Install a version that onebend knows: pip install '{VERSIONS}'"
        ) from None
    return table


MCAP_MAGIC = b"\x89MCAP0\r\n"
ROS1_MAGIC = b"#ROSBAG V2.0\n"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no message begins so: CDR begins with a zero
SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 3, 4, 5, 6, 15  # records of MCAP
ROS1_MESSAGE, ROS1_HEADER, ROS1_CHUNK, ROS1_CHUNK_INFO, ROS1_CONNECTION = 2, 3, 5, 6, 7


def scan(path: Path) -> Iterator[Item]:
    """Topics and messages of one file in its own order, read without its index.

    Raises:
        BrokenOffError: where it cannot be read further; what came before is good.
    """
    try:
        with path.open("rb") as stream:
            magic = stream.read(len(SQLITE_MAGIC))
            size = path.stat().st_size
            if magic.startswith(MCAP_MAGIC):
                stream.seek(len(MCAP_MAGIC))
                yield from map(opened, scan_mcap(stream, size))
            elif magic.startswith(ROS1_MAGIC):
                stream.seek(len(ROS1_MAGIC))
                yield from scan_ros1(stream, size)
            elif magic == SQLITE_MAGIC:
                yield from map(opened, scan_sqlite(path))
            else:
                raise BrokenOffError("it begins like no MCAP file, ROS 1 bag or sqlite3 file (is it a bag at all?)")
    except OSError as wrong:
        raise BrokenOffError(wrong.strerror or str(wrong)) from None


def opened(item: Item) -> Item:
    """The item with its message unpacked, where a recorder packs each for itself."""
    if isinstance(item, Channel) or not item[2].startswith(ZSTD_MAGIC):
        return item
    return item[0], item[1], unpack_zstd(item[2])


def scan_mcap(stream: BinaryIO, size: int) -> Iterator[Item]:
    """The records up to the end of data; chunks are unpacked."""
    declared = McapTables({}, {})
    for place, code, body in mcap_records(stream, size):
        if code == DATA_END:
            return
        try:
            if code != CHUNK:
                yield from mcap_item(code, body, declared)
                continue
            for _, inner, content in mcap_records(BytesIO(unpacked(body)), None):
                yield from mcap_item(inner, content, declared)
        except (struct.error, ValueError, UnicodeDecodeError) as wrong:
            raise BrokenOffError(f"the record at byte {place} is damaged ({wrong})") from None
        except BrokenOffError as wrong:
            raise BrokenOffError(f"the chunk at byte {place} is damaged: {wrong}") from None
    raise BrokenOffError(f"it ends at byte {size} without its end mark")


@dataclass(frozen=True)
class McapTables:
    """The schemas and channels that an MCAP file has declared so far."""

    schemas: dict[int, tuple[str, str, str]]  # name, encoding, definition
    channels: dict[int, Channel]


def mcap_item(code: int, body: bytes, declared: McapTables) -> Iterator[Item]:
    """The topic or message of one record, if it holds one; declarations are added to `declared`."""
    if code == SCHEMA:
        reader = Fields(body)
        key = reader.number("<H")
        declared.schemas[key] = (reader.text(), reader.text(), reader.text())
    elif code == CHANNEL:
        reader = Fields(body)
        key, schema = reader.number("<H"), reader.number("<H")
        name, kind, text = declared.schemas.get(schema, ("", "", ""))
        channel = Channel(reader.text(), message_type(name), reader.text(), text, idl=kind.endswith("idl"))
        declared.channels[key] = channel
        yield channel
    elif code == MESSAGE:
        key, _, received, _ = struct.unpack_from("<HIQQ", body)
        if key in declared.channels:
            yield declared.channels[key], received, body[22:]


def mcap_records(stream: BinaryIO, size: int | None) -> Iterator[tuple[int, int, bytes]]:
    """Place, code and content of every record; `size` is the file's, None within a chunk."""
    while head := stream.read(9):
        place = stream.tell() - len(head)
        length = struct.unpack("<Q", head[1:])[0] if len(head) == 9 else 0
        fits = size is None or length <= size - stream.tell()
        body = stream.read(length) if fits else b""
        if len(head) < 9 or len(body) < length:
            raise BrokenOffError(f"the record at byte {place} is cut off")
        yield place, head[0], body


def unpacked(chunk: bytes) -> bytes:
    """The records inside a chunk; its checksum must hold."""
    reader = Fields(chunk[16:])
    size, checksum = reader.number("<Q"), reader.number("<I")
    compression = reader.text()
    return unpack_mcap_chunk(reader.take(reader.number("<Q")), compression, size, checksum)


def message_type(name: str) -> str:
    """The name as rosbags keeps types: PACKAGE/msg/NAME, whether a bag writes the middle or not."""
    package, _, last = name.rpartition("/")
    return name if package.rpartition("/")[2] == "msg" else f"{package}/msg/{last}"


class Fields:
    """Numbers and texts of a record, one after the other."""

    def __init__(self, body: bytes) -> None:
        self.body, self.position = body, 0

    def take(self, count: int) -> bytes:
        if self.position + count > len(self.body):
            raise ValueError("a field is longer than its record")
        self.position += count
        return self.body[self.position - count : self.position]

    def number(self, layout: str) -> int:
        return int(struct.unpack(layout, self.take(struct.calcsize(layout)))[0])

    def text(self) -> str:
        return self.take(self.number("<I")).decode()


def scan_ros1(stream: BinaryIO, size: int) -> Iterator[Item]:
    """The records up to the index; chunks are unpacked."""
    channels: dict[int, Channel] = {}
    index = 0
    for place, header, body in ros1_records(stream, size):
        code = header.get("op", b"\0")[0]
        try:
            if code == ROS1_HEADER:
                index = struct.unpack("<Q", header["index_pos"])[0]
            elif code == ROS1_CHUNK_INFO:
                return
            elif code == ROS1_CHUNK:
                kind = header["compression"].decode()
                for _, inner, content in ros1_records(BytesIO(unpack_ros1_chunk(body, kind)), None):
                    yield from ros1_item(inner, content, channels)
            else:
                yield from ros1_item(header, body, channels)
        except (struct.error, KeyError, ValueError, UnicodeDecodeError) as wrong:
            raise BrokenOffError(f"the record at byte {place} is damaged ({wrong})") from None
        except BrokenOffError as wrong:
            raise BrokenOffError(f"the chunk at byte {place} is damaged: {wrong}") from None
    if index > size:
        raise BrokenOffError(f"it ends at byte {size}, before its index at byte {index}")


def ros1_item(header: dict[str, bytes], body: bytes, channels: dict[int, Channel]) -> Iterator[Item]:
    """The topic or message of one record of a ROS 1 bag, if it holds one."""
    code = header.get("op", b"\0")[0]
    if code == ROS1_CONNECTION:
        key = struct.unpack("<I", header["conn"])[0]
        connection = ros1_fields(body)
        kind, text = message_type(connection["type"].decode()), connection["message_definition"].decode()
        channels[key] = Channel(header["topic"].decode(), kind, "ros1", text, idl=False)
        yield channels[key]
    elif code == ROS1_MESSAGE:
        seconds, rest = struct.unpack("<II", header["time"])
        channel = channels.get(struct.unpack("<I", header["conn"])[0])
        if channel is not None:
            yield channel, seconds * 10**9 + rest, body


def ros1_records(stream: BinaryIO, size: int | None) -> Iterator[tuple[int, dict[str, bytes], bytes]]:
    """Place, header fields and content of every record; `size` is the file's, None within a chunk."""
    while first := stream.read(4):
        place = stream.tell() - len(first)
        parts = []
        for part in range(2):
            count = first if part == 0 else stream.read(4)
            length = struct.unpack("<I", count)[0] if len(count) == 4 else 0
            fits = size is None or length <= size - stream.tell()
            parts.append(stream.read(length) if fits else b"")
            if len(count) < 4 or len(parts[-1]) < length:
                raise BrokenOffError(f"the record at byte {place} is cut off")
        try:
            yield place, ros1_fields(parts[0]), parts[1]
        except (struct.error, ValueError) as wrong:
            raise BrokenOffError(f"the record at byte {place} is damaged ({wrong})") from None


def ros1_fields(body: bytes) -> dict[str, bytes]:
    """`name=value` fields of a ROS 1 header."""
    fields, start = {}, 0
    while start < len(body):
        end = start + 4 + struct.unpack_from("<I", body, start)[0]
        if end > len(body):
            raise ValueError("a field is longer than its header")
        name, _, value = body[start + 4 : end].partition(b"=")
        fields[name.decode()] = value
        start = end
    return fields
