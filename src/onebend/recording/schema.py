"""How a table of a TOML file becomes a frozen record.

A field is declared once with `key(...)`, and explained once in `keys.toml`; reading, units, messages with lines, and
the template follow from that."""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from onebend.text_files import ascii_only, quoted

LARGEST, SMALLEST = 1e13, 1e-12  # no quantity is larger in its unit (a modulus, a clock); what is smaller is zero
MOST_WHOLE = 2**31 - 1
LONGEST_TEXT = 1000  # characters of a name or a path
LONGEST_KEY = 100  # characters that are compared and shown
MOST_SHOWN = 20  # mistakes

Place = tuple[str | int, ...]  # ("tags", "on_beam", 0, "s"): where a value stands in the file
Check = Callable[[Any], Any]  # returns the value in SI and radians, or raises ValueError with what should stand there
Record = TypeVar("Record")


@dataclass(frozen=True)
class Key:
    """A key of the file: its name with the unit, its check, an example as TOML, and one line of explanation."""

    name: str
    check: Check
    example: str = ""
    says: str = ""


def key(name: str, check: Check, default: Any = dataclasses.MISSING) -> Any:
    """A dataclass field read from the file. Required without a default. `keys.toml` beside the module explains it."""
    return field(default=default, metadata={"key": Key(name, check)})


def keys_of(record: type) -> dict[str, tuple[Key, bool]]:
    """Field name -> (key, required) of a record declared with `key`, in the order of declaration."""
    said = explanations(Path(str(sys.modules[record.__module__].__file__)).with_name("keys.toml"))
    own = said.get("every", {}) | said.get(record.__name__, {})
    declared = [(entry, entry.metadata["key"]) for entry in dataclasses.fields(record) if "key" in entry.metadata]
    return {
        entry.name: (Key(one.name, one.check, *own[one.name]), entry.default is dataclasses.MISSING)
        for entry, one in declared
    }


@cache
def explanations(path: Path) -> dict[str, dict[str, tuple[str, str]]]:
    """By record and name of a key: its example and its explanation, from lines `name = example  # explanation`."""
    tables: dict[str, dict[str, tuple[str, str]]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        name, equals, rest = line.partition(" = ")
        if line.startswith("["):
            tables[line.strip("[]")] = {}
        elif equals and tables:
            example, _, says = rest.partition("  # ")
            list(tables.values())[-1][name] = (example, says)
    return tables


def number(*, above: float = -math.inf, least: float = -math.inf, most: float = math.inf, scale: float = 1.0) -> Check:
    """A finite number, larger than `above` and in [`least`, `most`], multiplied by `scale`."""
    wanted = f"a number above {above:g}" if math.isfinite(above) else "a number"
    if math.isfinite(least):
        wanted += f" between {least:g} and {most:g}" if math.isfinite(most) else f" of at least {least:g}"
    elif math.isfinite(most):
        wanted += f" {'and' if math.isfinite(above) else 'of'} at most {most:g}"

    def check(value: Any) -> float:
        if not isinstance(value, int | float) or isinstance(value, bool) or not -LARGEST <= value <= LARGEST:
            raise ValueError(wanted)
        size = float(value) if abs(value) >= SMALLEST else 0.0
        if not above < size or not least <= size <= most:
            raise ValueError(wanted)
        return size * scale

    return check


def whole(*, least: int) -> Check:
    """A whole number of at least `least`."""

    def check(value: Any) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= MOST_WHOLE:
            raise ValueError(f"a whole number of at least {least}")
        return value

    return check


def text(value: Any) -> str:
    """Text that is not empty."""
    if not isinstance(value, str) or not value.strip() or len(value) > LONGEST_TEXT:
        raise ValueError('text in quotes, such as "video.mp4"')
    return value


def flag(value: Any) -> bool:
    """true or false."""
    if not isinstance(value, bool):
        raise ValueError("true or false")
    return value


def one_of(*choices: str) -> Check:
    """One of a few words."""

    def check(value: Any) -> str:
        if value not in choices:
            similar = difflib.get_close_matches(str(value)[:LONGEST_KEY], choices, n=1)
            hint = f' (did you mean "{similar[0]}"?)' if similar else ""
            raise ValueError("one of " + ", ".join(f'"{choice}"' for choice in choices) + hint)
        return str(value)

    return check


def several(item: Check, *counts: int, least: int = 0) -> Check:
    """A list with one of the given numbers of entries (or `least` numbers), each passing `item`; kept as a tuple."""
    wanted = f"at least {least} numbers" if least else f"{' or '.join(map(str, counts))} entries"

    def check(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list) or (len(value) < least if least else len(value) not in counts):
            raise ValueError(f"a list of {wanted}")
        try:
            return tuple(item(entry) for entry in value)
        except ValueError as wrong:
            raise ValueError(f"a list in which each entry is {wrong}") from None

    return check


class Mistakes:
    """What is wrong with one file, collected so that a person can mend it in one go."""

    def __init__(self, file: str, content: str, homes: Mapping[str, Sequence[str]] = MappingProxyType({})) -> None:
        self.file = file
        self.homes = homes  # the tables that know a key
        self.lines = lines_of_keys(content)
        self.found: list[tuple[int, str]] = []

    def add(self, place: Place, message: str) -> None:
        """Note a mistake at `place`; it is given the line of the nearest table that stands in the file."""
        while place and place not in self.lines:
            place = place[:-1]
        self.found.append((self.lines.get(place, 1), message))

    def __str__(self) -> str:
        lines = [f"{self.file}:{line}: {message}" for line, message in sorted(self.found)[:MOST_SHOWN]]
        more = len(self.found) - MOST_SHOWN
        return "\n".join([*lines, *([f"There are {more} more mistakes like these."] if more > 0 else [])])


def read_table(record: type[Record], table: Any, place: Place, mistakes: Mistakes, **others: Any) -> Record | None:
    """The record that `table` describes, or None with the reasons in `mistakes`; `others`: fields without a key."""
    name = place_name(place)
    if not isinstance(table, dict):
        mistakes.add(place, f"{name} must be a table, not {quoted(table)}.")
        return None
    before = len(mistakes.found)
    keys = keys_of(record)
    report_unknown(table, [entry.name for entry, _ in keys.values()] + list(others), place, mistakes)
    values: dict[str, Any] = {}
    for field_name, (entry, required) in keys.items():
        if entry.name in table:
            try:
                values[field_name] = entry.check(table[entry.name])
            except ValueError as wrong:
                shown = quoted(table[entry.name])
                mistakes.add(
                    (*place, entry.name), f"{name} {entry.name} must be {wrong}, not {shown}. It is {entry.says}."
                )
        elif required:
            mistakes.add(place, f"{name} lacks {entry.name}: {entry.says}. Add `{entry.name} = {entry.example}`.")
    if len(mistakes.found) > before:
        return None
    return record(**values, **others)


def read_rows(record: type[Record], rows: list[Any], place: Place, mistakes: Mistakes) -> tuple[Record, ...]:
    """The records that a list of tables describes, without those that are wrong."""
    read = [read_table(record, row, (*place, i), mistakes) for i, row in enumerate(rows)]
    return tuple(one for one in read if one is not None)


def report_unknown(table: dict[str, Any], known: list[str], place: Place, mistakes: Mistakes) -> None:
    """Note every key of `table` that is not among `known`, with the likeliest intended one."""
    for name in table:
        if name not in known:
            few = len(mistakes.found) <= MOST_SHOWN  # the others are not shown
            similar = difflib.get_close_matches(name[:LONGEST_KEY], known, n=1, cutoff=0.5) if few else []
            hint = f"Did you mean {similar[0]}?" if similar else "Known here: " + ", ".join(known) + "."
            if homes := mistakes.homes.get(name):
                hint = "It belongs into " + " or ".join(f"[{table}]" for table in homes) + "."
            shown = ascii_only(name if len(name) <= LONGEST_KEY else f"{name[:LONGEST_KEY]}...")
            mistakes.add((*place, name), f"{place_name(place)} does not know the key {shown}. {hint}")


def place_name(place: Place) -> str:
    """`[tags.on_beam] (entry 2)` for ("tags", "on_beam", 1)."""
    words = [part for part in place if isinstance(part, str)]
    counts = [part for part in place if isinstance(part, int)]
    name = f"[{'.'.join(words)}]" if words else "the file"
    return f"{name} (entry {counts[-1] + 1})" if counts else name


HEADER = re.compile(r"^\s*(\[\[?)\s*([A-Za-z0-9_.\-\s\"']+?)\s*\]\]?\s*(#.*)?$")
ASSIGNMENT = re.compile(r"^\s*([A-Za-z0-9_.\-\"']+)\s*=")


def lines_of_keys(content: str) -> dict[Place, int]:
    """Line (from 1) of every table header and `key =` at the start of a line; good enough to point a person there.

    Keys inside inline tables and in the continuation of a multi-line value are not found; their table is.
    """
    lines: dict[Place, int] = {}
    counts: dict[Place, int] = {}
    table: Place = ()
    for line, row in enumerate(content.splitlines(), start=1):
        if header := HEADER.match(row):
            table = tuple(part.strip(" \"'") for part in header[2].split("."))
            if header[1] == "[[":
                counts[table] = counts.get(table, -1) + 1
                lines.setdefault(table, line)
                table = (*table, counts[table])
            lines.setdefault(table, line)
        elif assignment := ASSIGNMENT.match(row):
            parts = tuple(part.strip("\"'") for part in assignment[1].split("."))
            lines.setdefault((*table, *parts), line)
    return lines
