"""ROS 1 and ROS 2 bags without a ROS installation, whole or damaged."""

from __future__ import annotations

import difflib
import keyword
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from onebend.errors import RecordingError
from onebend.extras import require
from onebend.text_files import MOST_ROWS, NAMES, QUOTED, ascii_only, quoted, read_text

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict
    from rosbags.typesys.store import Typestore


import bz2
import sqlite3
import struct
import sys
from contextlib import closing, contextmanager
from importlib import import_module
from io import BytesIO
from os import truncate
from shutil import copyfile
from tempfile import TemporaryDirectory
from typing import BinaryIO
from zlib import crc32

MOST_CHUNK = 2**28  # bytes that one chunk or message may unpack to
MOST_READ, MOST_GAIN = 2**28, 200  # of one file: bytes whatever its size, and times that size
STEP = 2**20  # bytes unpacked at a time


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


def zstd() -> Any:
    """The module that unpacks zstd: of Python's own library from 3.14 on, else the one that rosbags installs."""
    return import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")


class Unpacker:
    """Unpacks the chunks of one file, as long as they come to no more than a film or a log does."""

    def __init__(self, path: Path) -> None:
        self.left = MOST_READ + MOST_GAIN * path.stat().st_size  # bytes

    def take(self, count: int) -> None:
        """Count bytes that were unpacked."""
        self.left -= count
        if self.left < 0:
            raise BrokenOffError("it unpacks to far more than a film or a log comes to")

    def unpack(self, packed: bytes, kind: str, size: int = 0) -> bytes:
        """The bytes of a chunk that is packed as `kind` and says that it has `size` bytes (0: it does not say)."""
        most = min(size, MOST_CHUNK) if size else MOST_CHUNK
        try:
            return b"".join(self._parts(packed, kind, most))
        except BrokenOffError:
            raise
        except Exception as wrong:  # zstd, lz4 and bz2 each have an error of their own, or a RuntimeError
            raise BrokenOffError(f"it cannot be unpacked ({wrong})") from None

    def _parts(self, packed: bytes, kind: str, most: int) -> Iterator[bytes]:
        if kind in ("", "none"):
            self.take(len(packed))
            yield packed
            return
        size, one = 0, _decompressor(kind)
        while True:
            part = one.decompress(packed, STEP)
            packed = b""
            size += len(part)
            self.take(len(part))
            if size > most:
                raise BrokenOffError(f"it unpacks to more than the {most} bytes that it may")
            yield part
            if one.eof and one.unused_data:  # several frames, one after the other
                packed, one = one.unused_data, _decompressor(kind)
            elif one.eof:
                return
            elif not part:
                raise BrokenOffError("it is cut off")


def _decompressor(kind: str) -> Any:
    if kind == "zstd":
        return zstd().ZstdDecompressor()
    if kind == "lz4":
        return import_module("lz4.frame").LZ4FrameDecompressor()
    if kind == "bz2":
        return bz2.BZ2Decompressor()
    raise BrokenOffError(f"it is packed as {kind!r}, which is not known")


MCAP_MAGIC = b"\x89MCAP0\r\n"
ROS1_MAGIC = b"#ROSBAG V2.0\n"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no message begins so: CDR begins with a zero
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, STATISTICS, DATA_END = 2, 3, 4, 5, 6, 11, 15  # records of MCAP
MCAP_FOOTER = struct.pack("<BQ", FOOTER, 20)  # how the last record begins
ROS1_MESSAGE, ROS1_HEADER, ROS1_CHUNK, ROS1_CHUNK_INFO, ROS1_CONNECTION = 2, 3, 5, 6, 7


def is_packed(path: Path) -> bool:
    """Whether the file is packed as a whole."""
    with path.open("rb") as stream:
        return stream.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC


def scan(path: Path, topic: str = "", unpacker: Unpacker | None = None) -> Iterator[Item]:
    """Topics and messages of one file in its own order, without its index; with `topic` others may be left out."""
    try:
        unpacker = unpacker or Unpacker(path)
        with path.open("rb") as stream:
            magic = stream.read(len(SQLITE_MAGIC))
            size = path.stat().st_size
            if magic.startswith(ZSTD_MAGIC):
                yield from scan_packed(path, topic, unpacker)
            elif magic.startswith(MCAP_MAGIC):
                stream.seek(len(MCAP_MAGIC))
                yield from unpacked(scan_mcap(stream, size, unpacker), unpacker)
            elif magic.startswith(ROS1_MAGIC):
                stream.seek(len(ROS1_MAGIC))
                yield from scan_ros1(stream, size, unpacker)
            elif magic == SQLITE_MAGIC:
                yield from unpacked(scan_sqlite(path, topic), unpacker)
            else:
                raise BrokenOffError("it begins like no MCAP file, ROS 1 bag or sqlite3 file (is it a bag at all?)")
    except OSError as wrong:
        raise BrokenOffError(wrong.strerror or str(wrong)) from None


def scan_packed(path: Path, topic: str, unpacker: Unpacker) -> Iterator[Item]:
    """Topics and messages of a file that is packed as a whole."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / path.stem
        try:
            with zstd().open(path, "rb") as packed, file.open("wb") as out:
                while data := packed.read(STEP):
                    unpacker.take(len(data))
                    out.write(data)
        except (EOFError, zstd().ZstdError) as wrong:
            raise BrokenOffError(f"it cannot be unpacked ({wrong})") from None
        yield from scan(file, topic, unpacker)


def unpacked(items: Iterator[Item], unpacker: Unpacker) -> Iterator[Item]:
    """The items with their messages unpacked, where a recorder packs each for itself."""
    for item in items:
        if isinstance(item, Channel) or not item[2].startswith(ZSTD_MAGIC):
            yield item
        else:
            yield item[0], item[1], unpacker.unpack(item[2], "zstd")


def topics_by_index(path: Path) -> list[tuple[Channel, int]] | None:
    """Topics and numbers of their messages by the file's own index; None where it has none, or a wrong one."""
    try:
        with path.open("rb") as stream:
            magic = stream.read(len(SQLITE_MAGIC))
            if magic.startswith(MCAP_MAGIC):
                return mcap_topics(stream, path.stat().st_size)
            if magic.startswith(ROS1_MAGIC):
                stream.seek(len(ROS1_MAGIC))
                return ros1_topics(stream, path.stat().st_size)
        if magic != SQLITE_MAGIC or lacking(path):
            return None
        with open_database(path) as base:
            counts = dict(base.execute("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
            return [(channel, counts.get(key, 0)) for key, channel in sqlite_channels(base).items()]
    except (BrokenOffError, struct.error, sqlite3.Error, ValueError, KeyError, OSError):
        return None


def mcap_topics(stream: BinaryIO, size: int) -> list[tuple[Channel, int]] | None:
    """As `topics_by_index`, by the summary at the file's end."""
    stream.seek(max(size - 37, 0))
    footer = stream.read()
    begin = struct.unpack_from("<Q", footer, 9)[0]
    if not begin or not footer.startswith(MCAP_FOOTER) or not footer.endswith(MCAP_MAGIC):
        return None
    stream.seek(begin)
    declared, counts = McapTables({}, {}), None
    for _, code, body in mcap_records(stream, size):
        if code == FOOTER:
            break
        if code == STATISTICS:
            counts = dict(struct.iter_unpack("<HQ", body[46 : 46 + struct.unpack_from("<I", body, 42)[0]]))
        for _ in mcap_item(code, body, declared):
            pass
    if counts is None or not set(counts) <= set(declared.channels):
        return None
    return [(channel, counts.get(key, 0)) for key, channel in declared.channels.items()]


def ros1_topics(stream: BinaryIO, size: int) -> list[tuple[Channel, int]] | None:
    """As `topics_by_index`, by the records behind the last chunk."""
    _, header, _ = next(ros1_records(stream, size), (0, {}, b""))
    begin = struct.unpack("<Q", header["index_pos"])[0]
    if not 0 < begin < size:
        return None
    stream.seek(begin)
    channels: dict[int, Channel] = {}
    counts: dict[int, int] = {}
    for _, fields, body in ros1_records(stream, size):
        for _ in ros1_item(fields, body, channels):
            pass
        if fields["op"][0] == ROS1_CHUNK_INFO:
            for key, count in struct.iter_unpack("<II", body):
                counts[key] = counts.get(key, 0) + count
    return [(channels[key], counts.get(key, 0)) for key in {**channels, **counts}]


def scan_mcap(stream: BinaryIO, size: int, unpacker: Unpacker) -> Iterator[Item]:
    """The records up to the end of data; chunks are unpacked."""
    declared = McapTables({}, {})
    for place, code, body in mcap_records(stream, size):
        if code == DATA_END:
            return
        try:
            if code != CHUNK:
                yield from mcap_item(code, body, declared)
                continue
            for _, inner, content in mcap_records(BytesIO(unpack_chunk(body, unpacker)), None):
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


def unpack_chunk(chunk: bytes, unpacker: Unpacker) -> bytes:
    """The records inside a chunk of an MCAP file; its size and its CRC-32 (0: none) must hold."""
    reader = Fields(chunk[16:])
    size, checksum = reader.number("<Q"), reader.number("<I")
    compression = reader.text()
    content = unpacker.unpack(reader.take(reader.number("<Q")), compression, size)
    if len(content) != size:
        raise BrokenOffError(f"it holds {len(content)} bytes and says that it has {size}")
    if checksum and crc32(content) != checksum:
        raise BrokenOffError("its checksum does not hold")
    return content


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


def scan_ros1(stream: BinaryIO, size: int, unpacker: Unpacker) -> Iterator[Item]:
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
                for _, inner, content in ros1_records(BytesIO(unpacker.unpack(body, kind)), None):
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


PLAIN_TABLE = re.compile(r"\s*CREATE\s+TABLE\b", re.IGNORECASE)
COLUMNS = "SELECT * FROM pragma_table_xinfo(?)"
COMPUTED = {2, 3}  # what the last of these columns says of one that is computed
SQLITE_MAGIC = b"SQLite format 3\0"


def scan_sqlite(path: Path, topic: str = "") -> Iterator[Item]:
    """Topics, then messages (with `topic` those of that one alone), up to the first page that is cut."""
    try:
        with whole_pages(path) as file, open_database(file) as base:
            refuse_programs(base)
            base.execute("PRAGMA writable_schema=ON")  # else a file shorter than it says is refused as a whole
            channels = sqlite_channels(base)
            yield from channels.values()
            wanted = [key for key, channel in channels.items() if channel.topic == topic]
            where = f"WHERE topic_id IN ({', '.join('?' * len(wanted))})" if topic else ""
            query = f"SELECT topic_id, timestamp, data FROM messages {where} ORDER BY rowid"
            for key, received, data in base.execute(query, wanted if topic else ()):
                if key in channels:
                    if not isinstance(received, int) or not isinstance(data, bytes):
                        raise BrokenOffError("a row of its messages has no time, or no bytes")
                    yield channels[key], received, data
    except sqlite3.Error as wrong:
        raise BrokenOffError(lacking(path) or str(wrong)) from None
    if lack := lacking(path):
        raise BrokenOffError(lack)


def open_database(path: Path) -> closing[sqlite3.Connection]:
    """The database, which is not written to."""
    return closing(sqlite3.connect(f"{path.resolve().as_uri()}?immutable=1", uri=True))


def sqlite_channels(base: sqlite3.Connection) -> dict[int, Channel]:
    """The topics by their keys."""
    texts = {}
    if "message_definitions" in {name for (name,) in base.execute("SELECT name FROM sqlite_master")}:
        rows = base.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        texts = {kind: (text, encoding.endswith("idl")) for kind, encoding, text in rows}
    channels = {}
    for key, name, kind, encoding in base.execute("SELECT id, name, type, serialization_format FROM topics"):
        if not all(isinstance(text, str) for text in (name, kind, encoding)):
            raise BrokenOffError("a topic without a name, a type or a packing")
        channels[key] = Channel(name, kind, encoding, *texts.get(kind, ("", False)))
    return channels


def refuse_programs(base: sqlite3.Connection) -> None:
    """Raise `BrokenOffError` where a recorder's table is computed: a view may have no end, a column be huge."""
    base.execute("PRAGMA trusted_schema=OFF")
    for kind, name, text in base.execute("SELECT type, name, sql FROM sqlite_master LIMIT 1000"):
        plain = kind == "index" or (kind == "table" and PLAIN_TABLE.match(text or ""))
        if not plain or (kind == "table" and COMPUTED & {row[6] for row in base.execute(COLUMNS, (name,))}):
            raise BrokenOffError(f"its {kind} {str(name)[:60]!r} is no table of a recorder")


def check_database(path: Path) -> None:
    """Raise `BrokenOffError` where the file is a database that computes its messages, or cannot be read as one."""
    with path.open("rb") as stream:
        if stream.read(len(SQLITE_MAGIC)) != SQLITE_MAGIC:
            return
    try:
        with open_database(path) as base:
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
    """In words, how much of its stated length a database lacks; "" for a whole one, or for another file."""
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


# A bag brings the definitions of its own messages, and what decodes them is code made from these. So names must be
# names, and types must not hold themselves, nor grow beyond the size of a message.

MOST_TEXT = 200_000  # characters of a definition
LONGEST_LINE = 2000
MOST_FIELDS = 20_000  # numbers and texts of one message, types within types counted out, sequences as one
MOST_ITEMS = 10_000  # of an array of texts or messages
MOST_NUMBERS = 2**28  # of an array of numbers
DEEPEST = 30  # types within types
TYPE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,99}(/[A-Za-z][A-Za-z0-9_]{0,99}){1,3}")
FIELD_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,99}")


class HostileTypeError(Exception):
    """A definition that no message has; the text says why."""


def check_text(text: str) -> None:
    """Raise `HostileTypeError` where a definition is too long to be one."""
    if len(text) > MOST_TEXT or any(len(line) > LONGEST_LINE for line in text.splitlines()):
        raise HostileTypeError(f"a definition of {len(text)} characters is none")


def check_type_name(name: str) -> None:
    """Raise `HostileTypeError` where a name is not PACKAGE/msg/NAME."""
    if not TYPE_NAME.fullmatch(name):
        raise HostileTypeError(f"{name[:60]!r} is no name of a type")


def check_types(types: Typesdict, known: Typesdict) -> None:
    """Raise `HostileTypeError` where names are no names, a type holds itself, or a message grows without bound."""
    for name, (_, fields) in types.items():
        check_type_name(name)
        for field, _ in fields:
            if not FIELD_NAME.fullmatch(field) or keyword.iskeyword(field.lower()):
                raise HostileTypeError(f"{field[:60]!r} is no name of a field")
    sizes: dict[str, int] = {}
    for name in types:
        _size_of(name, {**known, **types}, sizes, ())


def _size_of(name: str, types: Typesdict, sizes: dict[str, int], outer: tuple[str, ...]) -> int:
    """Numbers and texts of one message of the type `name`; `outer` are the types that it stands in."""
    if name in sizes:
        return sizes[name]
    if name in outer:
        raise HostileTypeError(f"the type {name[:60]} holds itself")
    if len(outer) > DEEPEST:
        raise HostileTypeError("types are nested too deeply")
    if name not in types:
        raise HostileTypeError(f"the type {name[:60]} is not defined")
    size = 0
    for _, field in types[name][1]:
        size += _field_size(field, types, sizes, (*outer, name))
        if size > MOST_FIELDS:
            raise HostileTypeError(f"a message of the type {name[:60]} has more than {MOST_FIELDS} fields")
    sizes[name] = size
    return size


def _field_size(field: Any, types: Typesdict, sizes: dict[str, int], outer: tuple[str, ...]) -> int:
    from rosbags.interfaces import Nodetype

    kind, inside = field
    if kind == Nodetype.BASE:
        return 1
    if kind == Nodetype.NAME:
        return _size_of(inside, types, sizes, outer)
    item, count = inside
    each = _field_size(item, types, sizes, outer)
    if each == 0:
        raise HostileTypeError("a list of messages without a field")
    if kind == Nodetype.SEQUENCE:
        return each  # bounded by the message's bytes
    numbers = item[0] == Nodetype.BASE and item[1][0] not in ("string", "wstring")
    if count > (MOST_NUMBERS if numbers else MOST_ITEMS):
        raise HostileTypeError(f"an array of {count} entries")
    return 1 if numbers else each * int(count)


IDL_PART = "=" * 80 + "\n"


def decoder(path: Path, channel: Channel, definitions: Path | None) -> Callable[[bytes], Any]:
    """What turns messages' bytes into objects; `definitions`: a folder with .msg files, for a bag without them."""
    if channel.encoding not in ("cdr", "ros1"):
        raise RecordingError(
            f"{path}: {ascii_only(channel.topic)} is packed as {channel.encoding!r}; cdr and ros1 can be read."
        )
    try:
        check_type_name(channel.type)
        store = types_of(channel, definitions)
        store.get_msgdef(channel.type)
    except HostileTypeError as wrong:
        raise RecordingError(
            f"{path}: {ascii_only(channel.topic)} cannot be read: its definition says {ascii_only(str(wrong))}."
        ) from None
    except Exception as wrong:  # the parser's own, or what a definition that makes no sense leads to
        raise RecordingError(
            f"{path}: the type {channel.type} of {ascii_only(channel.topic)} is not known "
            f"({quoted(str(wrong), 200)}). The bag does not say what it "
            "holds: put its .msg files (and those that they name) into a folder as PACKAGE/msg/NAME.msg and write "
            'definitions = "FOLDER" beside topic.'
        ) from None
    if channel.encoding == "cdr":
        return lambda data: store.deserialize_cdr(data, channel.type)
    return lambda data: store.deserialize_ros1(data, channel.type)


def types_of(channel: Channel, definitions: Path | None) -> Typestore:
    """The types that the channel needs: its own definition first, else the standard ones and those of the folder."""
    require(("rosbags",), "ros")
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    types: Typesdict = {}
    check_text(channel.definition)
    if channel.definition and not channel.idl:
        store = get_typestore(Stores.EMPTY)
        types.update(get_types_from_msg(channel.definition, channel.type))
    elif channel.definition:
        store = get_typestore(Stores.EMPTY)
        for part in channel.definition.split(IDL_PART):
            text = part.partition("\n")[2] if part.startswith("IDL: ") else part
            if text.strip():
                types.update(get_types_from_idl(text))
    else:
        store = get_typestore(Stores.ROS1_NOETIC if channel.encoding == "ros1" else Stores.LATEST)
        for file in sorted(definitions.rglob("*.msg")) if definitions is not None else []:
            package = file.parent.parent.name if file.parent.name == "msg" else file.parent.name
            text = read_text(file, RecordingError)
            check_text(text)
            types.update(get_types_from_msg(text, f"{package}/msg/{file.stem}"))
        types = {name: fields for name, fields in types.items() if name not in store.fielddefs}
    check_types(types, store.fielddefs)
    store.max_sequence_length = MOST_NUMBERS
    store.register({name: ([], fields) for name, (_, fields) in types.items()})  # constants are not in messages
    return store


ENDINGS = (".mcap", ".db3", ".bag", ".active")  # a recorder that was killed leaves .bag.active


@dataclass(frozen=True)
class Topic:
    """One topic of a bag."""

    channel: Channel
    count: int  # messages


@dataclass(frozen=True)
class Bag:
    """A bag as it was found; messages are read from its files as they are asked for."""

    path: Path
    parts: tuple[Path, ...]  # its files in order
    scanned: bool  # whether it is read without its index
    topics: dict[str, Topic]
    fault: str = ""  # where it breaks off; empty: it does not

    @property
    def count(self) -> int:
        return sum(topic.count for topic in self.topics.values())


def is_bag(path: Path) -> bool:
    """Whether the path looks like a bag: a file by its ending, a folder by what it holds."""
    return path.suffix in ENDINGS if path.is_file() else path.is_dir() and bool(files_of(path))


def files_of(path: Path) -> tuple[Path, ...]:
    """The files with messages, in order; none where a folder holds none."""
    if path.is_file():
        return (path,)
    if not path.is_dir():  # a pipe, a device
        return ()
    files = [file for file in path.iterdir() if file.name.endswith((*ENDINGS, ".mcap.zstd", ".db3.zstd"))]
    return tuple(sorted(files, key=lambda file: natural(file.name)))


def natural(name: str) -> list[tuple[int, str]]:
    """A key that sorts run_2 before run_10."""
    words: list[tuple[int, str]] = []
    for letter in name:
        if letter.isdecimal() and words and words[-1][1] == "":
            words[-1] = (10 * words[-1][0] + int(letter), "")
        else:
            words.append((int(letter), "") if letter.isdecimal() else (0, letter))
    return words


def open_bag(path: Path, *, keep: bool = False) -> Bag:
    """Topics and counts of the bag at `path`: a file, or a folder with or without its metadata.

    A bag that was not closed is read without its index. With `keep` one that is damaged is read up to the damage.

    Raises:
        MissingPackageError: rosbags is not installed.
        RecordingError: there is none, or it is damaged and `keep` is false; with the place.
    """
    files = files_of(path) if path.exists() else ()
    if not files:
        raise RecordingError(f"{path} is no bag. Give a .mcap, .db3 or .bag file, or the folder that holds one.")
    require(("rosbags",), "ros")
    for file in files:
        refuse_journal(file)
        try:
            check_database(file)
        except (BrokenOffError, OSError) as wrong:
            raise RecordingError(f"{file} cannot be read: {wrong}. Record the bag again, or copy it anew.") from None
    indexed = [None if keep else topics_by_index(file) for file in files]
    if None not in indexed:
        return Bag(path, files, scanned=False, topics=together(part for part in indexed if part is not None))
    bag = scan_bag(path, files)
    if bag.fault and (not keep or not bag.count):
        raise damaged(bag, bag.fault)
    if not bag.topics and not keep:
        raise RecordingError(f"{path} cannot be read: it is not indexed, and no message is in it. Copy it again.")
    return replace(bag, scanned=keep or not any(is_packed(file) for file in files))


def refuse_journal(file: Path) -> None:
    """An error where a database has messages beside it that were not written into it yet."""
    journal = file.with_name(f"{file.name}-wal")
    if journal.is_file() and journal.stat().st_size:
        raise RecordingError(
            f"{file} was not closed: {journal.name} beside it holds messages that are not in it. Take them in with "
            f'`sqlite3 {file.name} "PRAGMA wal_checkpoint(TRUNCATE)"`, or remove that file to do without them.'
        )


def scan_bag(path: Path, files: Sequence[Path]) -> Bag:
    """The bag as a reading from front to back finds it, and where that ended."""
    channels: dict[str, Channel] = {}
    counts: Counter[str] = Counter()
    faults = []
    for file in files:
        try:
            for item in scan(file):
                channel = item if isinstance(item, Channel) else item[0]
                channels.setdefault(channel.topic, channel)
                counts[channel.topic] += not isinstance(item, Channel)
        except BrokenOffError as wrong:
            faults.append(f"{file.name}: {wrong}")
    topics = {name: Topic(channel, counts[name]) for name, channel in channels.items()}
    return Bag(path, tuple(files), scanned=True, topics=topics, fault="; ".join(faults))


def damaged(bag: Bag, fault: str) -> RecordingError:
    """The error for a bag that breaks off."""
    good = ", ".join(f"{topic.count} of {name}" for name, topic in bag.topics.items() if topic.count)
    text = f"{bag.path} is damaged: {fault}."
    if not good:
        return RecordingError(f"{text} No message can be read before that. Copy it again.")
    return RecordingError(
        f"{text} {bag.count} messages can be read before that ({good}). Copy it again, or write "
        'damaged = "keep" to use what is there.'
    )


def together(parts: Iterable[list[tuple[Channel, int]]]) -> dict[str, Topic]:
    """Topics by name; publishers and parts of one topic are added up."""
    topics: dict[str, Topic] = {}
    for part in parts:
        for channel, count in part:
            before = topics.get(channel.topic, Topic(channel, 0))
            topics[channel.topic] = replace(before, count=before.count + count)
    return topics


def topic_of(bag: Bag, name: str, where: str) -> Topic:
    """The topic `name`, for which `where` asks; `RecordingError` where there is none, or no message of it."""
    topic = bag.topics.get(name) or bag.topics.get(f"/{name}")
    if topic is not None and topic.count:
        return topic
    if topic is not None:
        raise RecordingError(f"{where}: {bag.path} holds no message of {name}. It holds {listed(bag)}.")
    similar = difflib.get_close_matches(name, bag.topics, n=1)
    hint = f" Did you mean {similar[0]}?" if similar else ""
    raise RecordingError(f"{where}: {bag.path} has no topic {name}. It holds {listed(bag)}.{hint}")


def listed(bag: Bag) -> str:
    """The topics with types and counts, in words."""
    rows = [
        ascii_only(f"{name[:QUOTED]} ({topic.channel.type[:QUOTED]}, {topic.count} messages)")
        for name, topic in sorted(bag.topics.items())[:NAMES]
    ]
    more = f"; and {len(bag.topics) - NAMES} more" if len(bag.topics) > NAMES else ""
    return f"{'; '.join(rows)}{more}" if rows else "no topic"


def raw_messages(bag: Bag, topic: Topic) -> Iterator[tuple[int, bytes]]:
    """When each message of the topic was received, ns, and its bytes, in the bag's order."""
    name, count = topic.channel.topic, 0
    for part in bag.parts:
        try:
            for item in scan(part, name):
                if isinstance(item, Channel) or item[0].topic != name:
                    continue
                if count == MOST_ROWS:
                    raise RecordingError(f"{bag.path}: {name} has more than {count} messages. Cut the bag.")
                count += 1
                yield item[1:]
        except BrokenOffError as wrong:
            if not bag.scanned:  # else `bag.fault` says so
                whole = scan_bag(bag.path, bag.parts)
                raise damaged(whole, whole.fault or str(wrong)) from None


def messages(bag: Bag, topic: Topic, definitions: Path | None = None) -> Iterator[tuple[int, Any]]:
    """When each message of the topic was received, ns, and the message as an object."""
    decode = decoder(bag.path, topic.channel, definitions)
    for count, (received, data) in enumerate(raw_messages(bag, topic)):
        try:
            decoded = decode(data)
        except Exception as wrong:  # numpy, struct and the decoder's own, each in its way
            raise RecordingError(
                f"{bag.path}: message {count} of {ascii_only(topic.channel.topic)} is no "
                f"{ascii_only(topic.channel.type)} ({ascii_only(str(wrong))})."
            ) from None
        yield received, decoded
