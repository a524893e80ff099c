"""Entries of the page's requests, and the command line that does the same."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
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


def asked_number(asked: Mapping[str, Any], key: str, least: float, most: float, usual: float) -> float:
    """A number of the request, default `usual`. Raises `StudioError` if out of range."""
    found = asked.get(key, usual)
    if isinstance(found, bool) or not isinstance(found, int | float) or not least <= found <= most:
        raise StudioError(f"{key}: a number from {least:g} to {most:g}")
    return float(found)


def number(asked: Mapping[str, Any], key: str) -> float:
    """A number of the request, one of `NUMBERS`."""
    return asked_number(asked, key, *NUMBERS[key])


def number_if_any(asked: Mapping[str, Any], key: str) -> float | None:
    """None: the command's own."""
    return None if asked.get(key) is None else number(asked, key)


def asked_text(asked: Mapping[str, Any], key: str) -> str:
    """Text under this key, or "". Raises `StudioError` for other types or long text."""
    found = asked.get(key) or ""
    if not isinstance(found, str) or len(found) > _LONGEST or not found.isprintable():
        raise StudioError(f"{key}: give it as text, in at most {_LONGEST} characters")
    return found.strip()


def asked_name(asked: Mapping[str, Any], key: str = "name") -> str:
    """A name, which the studio's folder has to check."""
    return str(asked.get(key, ""))


def asked_goal(asked: Mapping[str, Any]) -> list[float]:
    """(x, y) m, to a nanometre: along a straight beam a micrometre takes much force. Raises `StudioError` for anything
    else."""
    goal = asked.get("goal_m")
    if not isinstance(goal, list) or len(goal) != 2:
        raise StudioError("a goal is (x, y) in m")
    return [round(asked_number({"goal": one}, "goal", -1e3, 1e3, 0.0), 9) for one in goal]


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


def check_command(name: str) -> str:
    """Of a recording; its picture is kept there."""
    return line("check", plain_word(name), output=f"{plain_word(name)}/check.png")


def plain_word(name: str) -> str:
    """A name that no command takes for an option."""
    return f"./{name}" if name.startswith("-") else name
