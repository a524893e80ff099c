"""Entries of the page's requests, and the command line that does the same."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

from onebend.errors import StudioError

_LONGEST = 1000  # characters of a text
NUMBERS = {  # least, most, default
    "push_s": (0.05, 1.0, 1.0),
    "point_s": (0.05, 1.0, 1.0),
    "k_error": (0.0, 0.95, 0.3),
    "delay_ms": (0.0, 10_000.0, 50.0),
    "fps": (0.1, 1000.0, 30.0),
    "noise_mm": (0.0, 1000.0, 0.05),
    "duration_s": (2.0, 600.0, 8.0),
    "max_force_N": (1e-6, 1e6, 1.0),
    "draws": (0, 8, 0),
    "until_percent": (0.01, 100.0, 100.0),
    "longest_s": (1.0, 1e5, 600.0),
    "crf": (0, 40, 18),
}


def object_of(value: Any) -> dict[str, Any]:
    """The value if it is an object, else an empty one: files may be of other hands."""
    return value if isinstance(value, dict) else {}


def objects_of(value: Any) -> list[dict[str, Any]]:
    return [one for one in value if isinstance(one, dict)] if isinstance(value, list) else []


class Asked(dict[str, Any]):
    """A request of the page. Raises `StudioError` for entries of other types, or out of range."""

    def number(self, key: str, within: tuple[float, float, float] | None = None) -> float:
        """`within`: the least, the most and the default; None: as in `NUMBERS`."""
        least, most, usual = within or NUMBERS[key]
        found = self.get(key, usual)
        if isinstance(found, bool) or not isinstance(found, int | float) or not least <= found <= most:
            raise StudioError(f"{key}: a number from {least:g} to {most:g}")
        return float(found)

    def number_if_any(self, key: str) -> float | None:
        """None: the command's own."""
        return None if self.get(key) is None else self.number(key)

    def text(self, key: str) -> str:
        """Without spaces around it; empty where there is none."""
        found = self.get(key) or ""
        if not isinstance(found, str) or len(found) > _LONGEST or not found.isprintable():
            raise StudioError(f"{key}: give it as text, in at most {_LONGEST} characters")
        return found.strip()

    def name(self, key: str = "name") -> str:
        """As it is: the studio's folder checks it."""
        return str(self.get(key, ""))

    @property
    def goal(self) -> list[float]:
        """(x, y) m, to a nanometre: along a straight beam a micrometre takes much force."""
        found = self.get("goal_m")
        if not isinstance(found, list) or len(found) != 2:
            raise StudioError("a goal is (x, y) in m")
        return [round(Asked(goal=one).number("goal", (-1e3, 1e3, 0.0)), 9) for one in found]


def line(*words: str, **options: bool | float | str | Sequence[float | str] | None) -> str:
    """A command with its options: none for None, False and "", a flag for True, numbers to a billionth of the unit."""
    for name, value in options.items():
        if value is not None and value is not False and value != "":
            given = () if value is True else (value,) if isinstance(value, str | int | float) else value
            rest = (one if isinstance(one, str) else rounded(one, 9) for one in given)
            words += (f"--{name.replace('_', '-')}", *rest)
    return shlex.join(("onebend", *words))


def rounded(value: float, digits: int) -> str:
    """Without trailing zeros."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def places_of(push_s: float, point_s: float) -> dict[str, float | None]:
    """Options for places other than the tip."""
    return {"push_at": None if push_s == 1.0 else push_s, "point": None if point_s == 1.0 else point_s}


def check_line(name: str) -> str:
    """Of a recording; its picture is kept there."""
    return line("check", plain(name), output=f"{plain(name)}/check.png")


def plain(name: str) -> str:
    """A name that no command takes for an option."""
    return f"./{name}" if name.startswith("-") else name
