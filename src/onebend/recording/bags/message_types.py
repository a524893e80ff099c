"""What the messages of a bag are made of: by the bag's own definitions, the standard ones, or given .msg files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from onebend.errors import RecordingError
from onebend.extras import require
from onebend.recording.bags.items import Channel
from onebend.recording.bags.type_limits import (
    MOST_NUMBERS,
    HostileTypeError,
    check_text,
    check_type_name,
    check_types,
    without_constants,
)
from onebend.text_files import ascii_only, quoted, read_text

if TYPE_CHECKING:  # as in the functions: most recordings are no bags
    from rosbags.interfaces.typing import Typesdict
    from rosbags.typesys.store import Typestore

IDL_PART = "=" * 80 + "\n"


def decoder(path: Path, channel: Channel, definitions: Path | None) -> Callable[[bytes], Any]:
    """What turns the bytes of the channel's messages into objects.

    `definitions` is a folder with .msg files, for a bag that does not carry them.

    Raises:
        RecordingError: the type is not known, or its definition cannot be read.
    """
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
    store.register(without_constants(types))
    return store
