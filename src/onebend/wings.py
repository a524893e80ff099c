"""The wings of the package, and its commands, which `commands.toml` lists in each folder that has some."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Literal, get_args

WINGS = ("live", "many", "lab", "drive", "studio")  # folders that may be left out, each with commands of its own

Group = Literal["Measure", "Learn", "Use", "Many", "Lab"]  # of commands, as `--help` lists them
GROUPS: tuple[Group, ...] = get_args(Group)


@dataclass(frozen=True)
class Place:
    """Where a command stands, the first line of its help, and the example at its end."""

    function: str  # "module:name"
    help: str
    example: str  # the words after `onebend NAME`; it works on what `make demo` made, and on what `first` makes
    first: str = ""  # the command that makes what the example needs beside that
    group: Group = "Use"

    def load(self) -> Callable[..., None]:
        """The function."""
        module, name = self.function.split(":")
        found: Callable[..., None] = getattr(import_module(module), name)
        return found


def commands_of(folder: str) -> dict[str, Place]:
    """The commands of one folder of the package, by name; none where the folder is left out."""
    file = Path(__file__).parent / folder / "commands.toml"
    listed = tomllib.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    return {name: Place(**entry) for name, entry in listed.items()}
