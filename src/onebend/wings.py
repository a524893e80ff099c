"""The wings of the package, and where a command stands: to list all commands loads none of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Literal, get_args

WINGS = ("live", "many", "lab", "drive", "studio")  # folders that may be left out, each with commands of its own

Group = Literal["Measure", "Learn", "Use", "Many", "Lab"]  # of commands, as `--help` lists them
GROUPS: tuple[Group, ...] = get_args(Group)


def wings() -> list[str]:
    """The wings that are here."""
    return [name for name in WINGS if (Path(__file__).parent / name / "__init__.py").is_file()]


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
