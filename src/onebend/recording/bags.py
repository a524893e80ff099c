"""ROS 1 and ROS 2 bags without a ROS installation, whole or damaged."""

from __future__ import annotations

import bz2
import difflib
import keyword
import re
import sqlite3
import struct
import sys
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, BinaryIO
from zlib import crc32

from onebend.errors import RecordingError
from onebend.extras import require
from onebend.text_files import MOST_ROWS, NAMES, QUOTED, ascii_only, quoted

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict
    from rosbags.typesys.store import Typestore

MOST_CHUNK = 2**28  # bytes that one chunk or message may unpack to
MOST_READ, MOST_GAIN = 2**28, 200  # of one file: bytes whatever its size, and times that size
STEP = 2**20  # bytes unpacked at a time


class BrokenOffError(ValueError):
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

    def unpack(self, packed: bytes, kind: str, size: int = MOST_CHUNK) -> bytes:
        """The bytes of a chunk that is packed as `kind` and says that it has `size` bytes."""
        if kind in ("", "none"):
            self.take(len(packed))
            return packed
        if kind not in ("zstd", "lz4", "bz2"):
            raise BrokenOffError(f"it is packed as {kind!r}, which is not known")
        module: Any = zstd() if kind == "zstd" else import_module("lz4.frame") if kind == "lz4" else bz2
        most = min(size, MOST_CHUNK, self.left)
        try:
            with module.open(BytesIO(packed)) as stream:
                content: bytes = stream.read(most + 1)
        except Exception as wrong:  # zstd, lz4 and bz2 each have an error of their own, or an EOFError
            raise BrokenOffError(f"it cannot be unpacked ({wrong})") from None
        self.take(len(content))
        if len(content) > most:
            raise BrokenOffError(f"it unpacks to more than the {most} bytes that it may")
        return content


class Fields:
    """Numbers and texts of a file or a record, one after the other."""

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self.stream, self.size = stream, size

    @classmethod
    def of(cls, content: bytes) -> Fields:
        return cls(BytesIO(content), len(content))

    @property
    def place(self) -> int:
        return self.stream.tell()

    def take(self, count: int) -> bytes:
        if self.place + count > self.size:
            raise BrokenOffError("it is cut off")
        return self.stream.read(count)

    def number(self, layout: str) -> int:
        return int(struct.unpack(layout, self.take(struct.calcsize(layout)))[0])

    def text(self) -> str:
        return self.take(self.number("<I")).decode()


@contextmanager
def damage_at(place: int) -> Iterator[None]:
    """Whatever is wrong with the record at `place` becomes a `BrokenOffError` that says where."""
    try:
        yield
    except (struct.error, KeyError, ValueError) as wrong:
        raise BrokenOffError(f"the record at byte {place} is damaged ({wrong})") from None


MCAP_MAGIC = b"\x89MCAP0\r\n"
ROS1_MAGIC = b"#ROSBAG V2.0\n"
SQLITE_MAGIC = b"SQLite format 3\0"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no message begins so: CDR begins with a zero
SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 3, 4, 5, 6, 15  # records of MCAP
ROS1_MESSAGE, ROS1_CHUNK, ROS1_CHUNK_INFO, ROS1_CONNECTION = 2, 5, 6, 7


def scan(path: Path, topic: str = "", unpacker: Unpacker | None = None) -> Iterator[Item]:
    """Topics and messages of one file in its own order, without its index; with `topic` others may be left out."""
    try:
        unpacker = unpacker or Unpacker(path)
        with path.open("rb") as stream:
            magic, size, ended = stream.read(len(SQLITE_MAGIC)), path.stat().st_size, True
            if magic.startswith(ZSTD_MAGIC):
                yield from scan_packed(path, topic, unpacker)
            elif magic.startswith(MCAP_MAGIC):
                stream.seek(len(MCAP_MAGIC))
                ended = yield from mcap_items(Fields(stream, size), {}, {}, unpacker)
            elif magic.startswith(ROS1_MAGIC):
                stream.seek(len(ROS1_MAGIC))
                ended = yield from ros1_items(Fields(stream, size), {}, unpacker)
            elif magic == SQLITE_MAGIC:
                yield from sqlite_items(path, topic, unpacker)
            else:
                raise BrokenOffError("it begins like no MCAP file, ROS 1 bag or sqlite3 file (is it a bag at all?)")
            if not ended:
                raise BrokenOffError(f"it ends at byte {size} without its end mark")
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


def mcap_items(
    content: Fields, schemas: dict[int, tuple[str, str, str]], channels: dict[int, Channel], unpacker: Unpacker
) -> Generator[Item, None, bool]:
    """Topics and messages of an MCAP file, or of a chunk in it; returns whether the end of data was seen.

    `schemas` (name, encoding, definition) and `channels` are those declared so far.
    """
    while content.place < content.size:
        with damage_at(content.place):
            code, record = content.number("<B"), Fields.of(content.take(content.number("<Q")))
            if code == DATA_END:
                return True
            if code == CHUNK:
                chunk = Fields.of(mcap_chunk(record, unpacker))
                yield from mcap_items(chunk, schemas, channels, unpacker)
            elif code == SCHEMA:
                key = record.number("<H")
                schemas[key] = (record.text(), record.text(), record.text())
            elif code == CHANNEL:
                key, (name, kind, text) = record.number("<H"), schemas.get(record.number("<H"), ("", "", ""))
                channel = Channel(record.text(), message_type(name), record.text(), text, idl=kind.endswith("idl"))
                channels[key] = channel
                yield channel
            elif code == MESSAGE:
                key, _, received, _ = struct.unpack("<HIQQ", record.take(22))
                if key in channels:
                    yield channels[key], received, own(record.stream.read(), unpacker)
    return False


def mcap_chunk(record: Fields, unpacker: Unpacker) -> bytes:
    """The records inside a chunk of an MCAP file; its size and its CRC-32 (0: none) must hold."""
    record.take(16)
    size, checksum = record.number("<Q"), record.number("<I")
    content = unpacker.unpack(kind=record.text(), packed=record.take(record.number("<Q")), size=size)
    if len(content) != size:
        raise BrokenOffError(f"it holds {len(content)} bytes and says that it has {size}")
    if checksum and crc32(content) != checksum:
        raise BrokenOffError("its checksum does not hold")
    return content


def own(message: bytes, unpacker: Unpacker) -> bytes:
    """The message, unpacked where the recorder packs each for itself."""
    return unpacker.unpack(message, "zstd") if message.startswith(ZSTD_MAGIC) else message


def message_type(name: str) -> str:
    """The name as rosbags keeps types: PACKAGE/msg/NAME, whether a bag writes the middle or not."""
    package, _, last = name.rpartition("/")
    return name if package.rpartition("/")[2] == "msg" else f"{package}/msg/{last}"


def ros1_items(content: Fields, channels: dict[int, Channel], unpacker: Unpacker) -> Generator[Item, None, bool]:
    """As `mcap_items`, of a ROS 1 bag, whose data end where its index begins."""
    while content.place < content.size:
        with damage_at(content.place):
            header = ros1_fields(content.take(content.number("<I")))
            body, code = content.take(content.number("<I")), header["op"][0]
            if code == ROS1_CHUNK_INFO:
                return True
            if code == ROS1_CHUNK:
                chunk = unpacker.unpack(body, header["compression"].decode())
                yield from ros1_items(Fields.of(chunk), channels, unpacker)
            elif code == ROS1_CONNECTION:
                about = ros1_fields(body)
                kind, text = message_type(about["type"].decode()), about["message_definition"].decode()
                channel = Channel(header["topic"].decode(), kind, "ros1", text, idl=False)
                channels[struct.unpack("<I", header["conn"])[0]] = channel
                yield channel
            elif code == ROS1_MESSAGE:
                (key,), (seconds, rest) = struct.unpack("<I", header["conn"]), struct.unpack("<II", header["time"])
                if key in channels:
                    yield channels[key], seconds * 10**9 + rest, body
    return False


def ros1_fields(body: bytes) -> dict[str, bytes]:
    """`name=value` fields of a ROS 1 header."""
    fields, record = {}, Fields.of(body)
    while record.place < record.size:
        name, _, value = record.take(record.number("<I")).partition(b"=")
        fields[name.decode()] = value
    return fields


PLAIN_TABLE = re.compile(r"\s*CREATE\s+TABLE\b", re.IGNORECASE)
COLUMNS = "SELECT * FROM pragma_table_xinfo(?)"
COMPUTED = {2, 3}  # what the last of these columns says of one that is computed


def sqlite_items(path: Path, topic: str, unpacker: Unpacker) -> Iterator[Item]:
    """Topics, then messages (with `topic` those of that one alone)."""
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?immutable=1", uri=True)) as base:  # not written to
            refuse_programs(base)
            (page,) = base.execute("PRAGMA page_size").fetchone()
            if path.stat().st_size % page:  # sqlite refuses a file that lacks whole pages, and takes half of one for it
                raise BrokenOffError("it is cut off")
            channels = sqlite_channels(base)
            yield from channels.values()
            wanted = [key for key, channel in channels.items() if topic in ("", channel.topic)]
            marks = ", ".join("?" * len(wanted))
            query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY rowid"
            for key, received, data in base.execute(query, wanted):
                if not isinstance(received, int) or not isinstance(data, bytes):
                    raise BrokenOffError("a row of its messages has no time, or no bytes")
                yield channels[key], received, own(data, unpacker)
    except sqlite3.Error as wrong:
        raise BrokenOffError(str(wrong)) from None


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


# A bag brings the definitions of its own messages, and what decodes them is code made from these. So names must be
# names, and arrays no larger than a message.

MOST_TEXT = 200_000  # characters of a definition
LONGEST_LINE = 2000
MOST_ITEMS = 100  # of an array of texts or messages
MOST_NUMBERS = 2**28  # of an array of numbers
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


def check_types(types: dict[str, Any]) -> None:
    """Raise `HostileTypeError` where names are no names, or an array of a fixed size is none of a message."""
    from rosbags.interfaces import Nodetype

    for name, (_, fields) in types.items():
        check_type_name(name)
        for field, (kind, inside) in fields:
            if not FIELD_NAME.fullmatch(field) or keyword.iskeyword(field.lower()):
                raise HostileTypeError(f"{field[:60]!r} is no name of a field")
            if kind == Nodetype.ARRAY:
                item, count = inside
                numbers = item[0] == Nodetype.BASE and item[1][0] not in ("string", "wstring")
                if count > (MOST_NUMBERS if numbers else MOST_ITEMS):
                    raise HostileTypeError(f"an array of {count} entries")


IDL_PART = "=" * 80 + "\n"


def decoder(path: Path, channel: Channel) -> Callable[[bytes], Any]:
    """What turns messages' bytes into objects."""
    if channel.encoding not in ("cdr", "ros1"):
        raise RecordingError(
            f"{path}: {ascii_only(channel.topic)} is packed as {channel.encoding!r}; cdr and ros1 can be read."
        )
    try:
        check_type_name(channel.type)
        store = types_of(channel)
        store.get_msgdef(channel.type)
    except HostileTypeError as wrong:
        raise RecordingError(
            f"{path}: {ascii_only(channel.topic)} cannot be read: its definition says {ascii_only(str(wrong))}."
        ) from None
    except Exception as wrong:  # the parser's own, or what a definition that makes no sense leads to
        raise RecordingError(
            f"{path}: the type {channel.type} of {ascii_only(channel.topic)} is not known "
            f"({quoted(str(wrong), 200)}). The bag does not say what it holds. Convert it to MCAP where ROS knows the "
            "type: `ros2 bag convert`."
        ) from None
    if channel.encoding == "cdr":
        return lambda data: store.deserialize_cdr(data, channel.type)
    return lambda data: store.deserialize_ros1(data, channel.type)


def types_of(channel: Channel) -> Typestore:
    """The types that the channel needs: its own definition, else the standard ones."""
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
    check_types(types)
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
    topics: dict[str, Topic]
    fault: str  # where it breaks off; empty: it does not

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


def natural(name: str) -> list[str | int]:
    """A key that sorts run_2 before run_10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)]


def open_bag(path: Path) -> Bag:
    """Topics and counts of the bag at `path`: a file, or a folder with or without its metadata.

    It is read from front to back, without its index, and one that is damaged up to the damage.

    Raises:
        MissingPackageError: rosbags is not installed.
        RecordingError: there is none, or no message can be read.
    """
    files = files_of(path) if path.exists() else ()
    if not files:
        raise RecordingError(f"{path} is no bag. Give a .mcap, .db3 or .bag file, or the folder that holds one.")
    require(("rosbags",), "ros")
    for file in files:
        journal = file.with_name(f"{file.name}-wal")
        if journal.is_file() and journal.stat().st_size:
            raise RecordingError(
                f"{file} was not closed: {journal.name} beside it holds messages that are not in it. Take them in with "
                f'`sqlite3 {file.name} "PRAGMA wal_checkpoint(TRUNCATE)"`, or remove that file to do without them.'
            )
    bag = scanned(path, files, tuple((file.stat().st_size, file.stat().st_mtime_ns) for file in files))
    if bag.fault and not bag.count:
        raise RecordingError(f"{path} is damaged: {bag.fault}. No message can be read before that. Copy it again.")
    if not bag.topics:
        raise RecordingError(f"{path} holds no message. Copy it again.")
    return bag


@lru_cache(maxsize=4)
def scanned(path: Path, files: tuple[Path, ...], state: tuple[tuple[int, int], ...]) -> Bag:
    """The bag as a reading finds it; `state`: size and time of change of each file, for which this holds."""
    del state
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
    return Bag(path, files, {name: Topic(one, counts[name]) for name, one in channels.items()}, "; ".join(faults))


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
        with suppress(BrokenOffError):  # `bag.fault` says so
            for item in scan(part, name):
                if isinstance(item, Channel) or item[0].topic != name:
                    continue
                if count == MOST_ROWS:
                    raise RecordingError(f"{bag.path}: {name} has more than {count} messages. Cut the bag.")
                count += 1
                yield item[1:]


def messages(bag: Bag, topic: Topic) -> Iterator[tuple[int, Any]]:
    """When each message of the topic was received, ns, and the message as an object."""
    decode = decoder(bag.path, topic.channel)
    for count, (received, data) in enumerate(raw_messages(bag, topic)):
        try:
            decoded = decode(data)
        except Exception as wrong:  # numpy, struct and the decoder's own, each in its way
            raise RecordingError(
                f"{bag.path}: message {count} of {ascii_only(topic.channel.topic)} is no "
                f"{ascii_only(topic.channel.type)} ({ascii_only(str(wrong))})."
            ) from None
        yield received, decoded
