"""Whether the types that a bag declares are such as messages have: before anything is made of them.

A bag brings the definitions of its own messages, and what decodes them is code made from these. So names must be names,
and types must not hold themselves, nor grow beyond what any message is, whatever its bytes say.
"""

from __future__ import annotations

import keyword
import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict

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


def without_constants(types: Typesdict) -> Typesdict:
    """The types with fields alone: constants are not in messages."""
    return {name: ([], fields) for name, (_, fields) in types.items()}


def check_types(types: Typesdict, known: Typesdict) -> None:
    """Raise `HostileTypeError` where names are no names, a type holds itself, or a message grows without bound.

    `known` are the types that need no check and may be named.
    """
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
