"""A package's public names, each loaded when it is first asked for: to import the package costs nothing."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

WINGS = ("live", "many", "lab", "studio")  # folders that may be left out, each with commands of its own


def wings() -> list[str]:
    """The wings that are here."""
    return [name for name in WINGS if (Path(__file__).parent / name / "__init__.py").is_file()]


def shown_names(file: str) -> dict[str, str]:
    """Module -> names (with spaces between) of the imports for type checkers at the top of a package's `file`."""
    first = next(node for node in ast.parse(Path(file).read_text(encoding="utf-8")).body if isinstance(node, ast.If))
    imports = [node for node in first.body if isinstance(node, ast.ImportFrom)]
    return {str(node.module): " ".join(name.name for name in node.names) for node in imports}


def lazy_names(
    package: str, homes: Mapping[str, str], *, inside: str = ""
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package (PEP 562).

    Args:
        package: its `__name__`.
        homes: module -> names in it, with spaces between, that the package shows as its own.
        inside: the package's own modules that it shows as well, with spaces between.
    """
    home = {name: module for module, names in homes.items() for name in names.split()}
    public = sorted((*home, *inside.split()))

    def load(name: str) -> Any:
        if name in home:
            found = getattr(import_module(home[name]), name)
            setattr(sys.modules[package], name, found)  # next time it is there
            return found
        if name in public:
            return import_module(f"{package}.{name}")
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *public})

    return load, names, public


# The command line. Results go to standard output, progress and errors to standard error.
#
# Exit codes: 0 done; 2 the input or the request cannot be used, with one message that says what to do, or a fault of
# onebend itself, with the file that says more; 130 interrupted. The list of commands stands here as text, so that
# `--version` and `--help` load no command; each loads what it needs.


@dataclass(frozen=True)
class Place:
    """Where a command stands, the first line of its help, and the example at its end."""

    function: str  # "module:name"
    help: str
    example: str  # the words after `onebend NAME`; it works on what `make demo` made, and on what `first` makes
    first: str = ""  # the command that makes what the example needs beside that

    def load(self) -> Callable[..., None]:
        """The function."""
        module, name = self.function.split(":")
        found: Callable[..., None] = getattr(import_module(module), name)
        return found
