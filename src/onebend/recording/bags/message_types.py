"""What the messages of a bag are made of: by the bag's own definitions, the standard ones, or given .msg files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosbags.interfaces.typing import Typesdict
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from onebend.errors import RecordingError
from onebend.recording.bags.items import Channel

IDL_PART = "=" * 80 + "\n"


def decoder(path: Path, channel: Channel, definitions: Path | None) -> Callable[[bytes], Any]:
    """What turns the bytes of the channel's messages into objects.

    `definitions` is a folder with .msg files, for a bag that does not carry them.

    Raises:
        RecordingError: the type is not known, or its definition cannot be read.
    """
    if channel.encoding not in ("cdr", "ros1"):
        raise RecordingError(f"{path}: {channel.topic} is packed as {channel.encoding!r}; cdr and ros1 can be read.")
    try:
        store = types_of(channel, definitions)
        store.get_msgdef(channel.type)
    except (TypesysError, SerdeError, KeyError) as wrong:
        raise RecordingError(
            f"{path}: the type {channel.type} of {channel.topic} is not known ({wrong}). The bag does not say what it "
            "holds: put its .msg files (and those that they name) into a folder as PACKAGE/msg/NAME.msg and write "
            'definitions = "FOLDER" beside topic.'
        ) from None
    if channel.encoding == "cdr":
        return lambda data: store.deserialize_cdr(data, channel.type)
    return lambda data: store.deserialize_ros1(data, channel.type)


def types_of(channel: Channel, definitions: Path | None) -> Typestore:
    """The types that the channel needs: its own definition first, else the standard ones and those of the folder."""
    types: Typesdict = {}
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
            types.update(get_types_from_msg(file.read_text(encoding="utf-8"), f"{package}/msg/{file.stem}"))
        types = {name: fields for name, fields in types.items() if name not in store.fielddefs}
    store.register(types)
    return store
