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
from onebend.recording.bag_files import BrokenOffError, Channel, check_database, is_packed, scan, topics_by_index
from onebend.text_files import MOST_ROWS, NAMES, QUOTED, ascii_only, quoted, read_text

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict
    from rosbags.typesys.store import Typestore


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
