"""A package's public names, each loaded when it is first asked for: to import the package costs nothing."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


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
