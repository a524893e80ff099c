"""ROS 1 and ROS 2 bags without a ROS installation: rosbags reads the files, their types and their messages."""

from __future__ import annotations

import difflib
import keyword
import re
import shutil
import sqlite3
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from onebend.errors import RecordingError
from onebend.extras import require
from onebend.text_files import MOST_ROWS, NAMES, QUOTED, ascii_only, quoted

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict
    from rosbags.typesys.store import Typestore

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no message begins so: CDR begins with a zero


@dataclass(frozen=True)
class Topic:
    """One topic of a bag, as the file that has it first declares it."""

    name: str
    type: str  # "geometry_msgs/msg/Wrench"
    encoding: str  # of the messages: "cdr" or "ros1"
    definition: str  # the message's definition as text; "" where the file has none
    idl: bool  # whether that is IDL, not MSG
    count: int = 0  # messages


def zstd() -> Any:
    """The module that unpacks zstd: of Python's own library from 3.14 on, else the one that rosbags installs."""
    return import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")


@contextmanager
def opened(file: Path) -> Iterator[Any]:
    """The reader that rosbags has for one file; what it cannot read is a `RecordingError`."""
    from rosbags import rosbag1, rosbag2

    try:
        with ExitStack() as stack:
            path = file
            if file.suffix == ".zstd":
                path = Path(stack.enter_context(TemporaryDirectory())) / file.stem
                with zstd().open(file, "rb") as packed, path.open("wb") as out:
                    shutil.copyfileobj(packed, out)
            if path.suffix == ".db3":
                refuse_programs(path)
                if set("?#%") & set(str(path)):  # rosbags writes its path into an address as it is
                    link = Path(stack.enter_context(TemporaryDirectory())) / "bag.db3"
                    link.symlink_to(path.resolve())
                    path = link
            reader: Any = rosbag1.Reader(path) if path.suffix in (".bag", ".active") else rosbag2.Reader(path)
            yield stack.enter_context(reader)
    except RecordingError:
        raise
    except Exception as wrong:  # of rosbags, sqlite, zstd or struct, each in its way
        raise RecordingError(
            f"{file} cannot be read: it is no bag, damaged, or without its index ({quoted(str(wrong), 200)}). Copy it "
            "again, or mend it: `rosbag reindex`, `ros2 bag reindex` or `mcap recover`.",
            about="damaged bag",
        ) from None


PLAIN_TABLE = re.compile(r"\s*CREATE\s+TABLE\b", re.IGNORECASE)
COLUMNS = "SELECT * FROM pragma_table_xinfo(?)"
COMPUTED = {2, 3}  # what the last of these columns says of one that is computed


def refuse_programs(path: Path) -> None:
    """Raise `ValueError` where a database is cut off, or a recorder's table is computed: a view may have no end, a
    column be huge."""
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?immutable=1", uri=True)) as base:  # not written to
        base.execute("PRAGMA trusted_schema=OFF")
        (page,) = base.execute("PRAGMA page_size").fetchone()
        if path.stat().st_size % page:  # sqlite refuses a file that lacks whole pages, and takes half of one for it
            raise ValueError("it is cut off")
        for kind, name, text in base.execute("SELECT type, name, sql FROM sqlite_master LIMIT 1000"):
            plain = kind == "index" or (kind == "table" and PLAIN_TABLE.match(text or ""))
            if not plain or (kind == "table" and COMPUTED & {row[6] for row in base.execute(COLUMNS, (name,))}):
                raise ValueError(f"its {kind} {str(name)[:60]!r} is no table of a recorder")


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


def decoder(path: Path, topic: Topic) -> Callable[[bytes], Any]:
    """What turns messages' bytes into objects."""
    if topic.encoding not in ("cdr", "ros1"):
        raise RecordingError(
            f"{path}: {ascii_only(topic.name)} is packed as {topic.encoding!r}; cdr and ros1 can be read."
        )
    try:
        check_type_name(topic.type)
        store = types_of(topic)
        store.get_msgdef(topic.type)
    except HostileTypeError as wrong:
        raise RecordingError(
            f"{path}: {ascii_only(topic.name)} cannot be read: its definition says {ascii_only(str(wrong))}."
        ) from None
    except Exception as wrong:  # the parser's own, or what a definition that makes no sense leads to
        raise RecordingError(
            f"{path}: the type {topic.type} of {ascii_only(topic.name)} is not known "
            f"({quoted(str(wrong), 200)}). The bag does not say what it holds. Convert it to MCAP where ROS knows the "
            "type: `ros2 bag convert`."
        ) from None
    if topic.encoding == "cdr":
        return lambda data: store.deserialize_cdr(data, topic.type)
    return lambda data: store.deserialize_ros1(data, topic.type)


def types_of(topic: Topic) -> Typestore:
    """The types that the topic needs: its own definition, else the standard ones."""
    require(("rosbags",), "ros")
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    types: Typesdict = {}
    check_text(topic.definition)
    if topic.definition and not topic.idl:
        store = get_typestore(Stores.EMPTY)
        types.update(get_types_from_msg(topic.definition, topic.type))
    elif topic.definition:
        store = get_typestore(Stores.EMPTY)
        for part in topic.definition.split(IDL_PART):
            text = part.partition("\n")[2] if part.startswith("IDL: ") else part
            if text.strip():
                types.update(get_types_from_idl(text))
    else:
        store = get_typestore(Stores.ROS1_NOETIC if topic.encoding == "ros1" else Stores.LATEST)
    check_types(types)
    store.max_sequence_length = MOST_NUMBERS
    store.register({name: ([], fields) for name, (_, fields) in types.items()})  # constants are not in messages
    return store


ENDINGS = (".mcap", ".db3", ".bag", ".active")  # a recorder that was killed leaves .bag.active


@dataclass(frozen=True)
class Bag:
    """A bag as it was found; messages are read from its files as they are asked for."""

    path: Path
    parts: tuple[Path, ...]  # its files in order
    topics: dict[str, Topic]


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

    Raises:
        MissingPackageError: rosbags is not installed.
        RecordingError: there is none, or it cannot be read.
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
    if not bag.topics:
        raise RecordingError(f"{path} holds no message. Copy it again.")
    return bag


@lru_cache(maxsize=4)
def scanned(path: Path, files: tuple[Path, ...], state: tuple[tuple[int, int], ...]) -> Bag:
    """The bag as its files declare it; `state`: size and time of change of each file, for which this holds."""
    del state
    topics: dict[str, Topic] = {}
    for file in files:
        with opened(file) as reader:
            for one in reader.connections:
                encoding = getattr(one.ext, "serialization_format", "ros1")
                definition, idl = one.msgdef.data, one.msgdef.format.name == "IDL"
                known = topics.get(one.topic) or Topic(one.topic, one.msgtype, encoding, definition, idl)
                topics[one.topic] = replace(known, count=known.count + one.msgcount)
    return Bag(path, files, topics)


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
        ascii_only(f"{name[:QUOTED]} ({topic.type[:QUOTED]}, {topic.count} messages)")
        for name, topic in sorted(bag.topics.items())[:NAMES]
    ]
    more = f"; and {len(bag.topics) - NAMES} more" if len(bag.topics) > NAMES else ""
    return f"{'; '.join(rows)}{more}" if rows else "no topic"


def raw_messages(bag: Bag, topic: Topic) -> Iterator[tuple[int, bytes]]:
    """When each message of the topic was received, ns, and its bytes, in the order of receipt."""
    name = topic.name
    if topic.count > MOST_ROWS:
        raise RecordingError(f"{bag.path}: {name} has more than {MOST_ROWS} messages. Cut the bag.")
    for part in bag.parts:
        with opened(part) as reader:
            chosen = [one for one in reader.connections if one.topic == name]
            for _, received, data in reader.messages(chosen) if chosen else ():
                if not isinstance(received, int) or not isinstance(data, bytes):
                    raise ValueError("a row of its messages has no time, or no bytes")
                yield received, zstd().decompress(data) if data.startswith(ZSTD_MAGIC) else data


def messages(bag: Bag, topic: Topic) -> Iterator[tuple[int, Any]]:
    """When each message of the topic was received, ns, and the message as an object."""
    decode = decoder(bag.path, topic)
    for count, (received, data) in enumerate(raw_messages(bag, topic)):
        try:
            decoded = decode(data)
        except Exception as wrong:  # numpy, struct and the decoder's own, each in its way
            raise RecordingError(
                f"{bag.path}: message {count} of {ascii_only(topic.name)} is no "
                f"{ascii_only(topic.type)} ({ascii_only(str(wrong))})."
            ) from None
        yield received, decoded
