"""Optional packages: a command that needs a missing one names the extra of onebend that installs it."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal

from onebend.errors import MissingPackageError

Extra = Literal["batch", "calibrate", "franka", "ros", "ros2", "sklearn", "studio", "ur"]


def package(name: str, extra: Extra) -> Any:
    """Import a module of an optional package and return it. It is imported where it is used: most commands need none.

    Raises:
        MissingPackageError: the package is not installed, or does not load.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as wrong:
        raise MissingPackageError(
            f"this needs the package {wrong.name}. Install it with: pip install 'onebend[{extra}]'", name=wrong.name
        ) from None
    except (ImportError, OSError, RuntimeError) as wrong:  # a system library that it needs
        raise MissingPackageError(f"the package {name} does not load: {wrong}", name=name) from None


def installed(name: str) -> bool:
    """Whether a package can be imported, without loading it."""
    return find_spec(name) is not None


def require(names: tuple[str, ...], extra: Extra) -> None:
    """Check that the packages are installed, without loading them.

    Raises:
        MissingPackageError: one of them is not.
    """
    if missing := [name for name in names if not installed(name)]:
        some = "package" if len(missing) == 1 else "packages"
        raise MissingPackageError(
            f"this needs the {some} {', '.join(missing)}. Install with: pip install 'onebend[{extra}]'", name=missing[0]
        )
