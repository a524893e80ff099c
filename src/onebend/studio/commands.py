"""The command lines that would do what the page does."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

MOST_DIGITS = 12  # behind the point, of a goal in metres


def line(*words: str) -> str:
    """`onebend ...`, for a shell."""
    return shlex.join(["onebend", *words])


def number(value: float) -> str:
    """Short, and exact to a micrometre or a millionth of the unit."""
    return (f"{value:.6f}".rstrip("0").rstrip(".") or "0") if math.isfinite(value) else "inf"


def rounded(value: float, digits: int) -> str:
    """With so many digits behind the point, less the zeros at the end."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def reach_line(model: str, goal: Sequence[float], digits: int, push_s: float, point_s: float, max_force: float) -> str:
    """What gives the force of a dragged point; `digits` of the goal in metres."""
    places = [] if push_s == 1.0 else ["--push-at", number(push_s)]
    places += [] if point_s == 1.0 else ["--point", number(point_s)]
    goals = [rounded(one, digits) for one in goal[:2]]
    return line("reach", model, "--goal", *goals, *places, "--max-force-N", number(max_force))


def hand_line(model: str, goal: Sequence[float]) -> str:
    """What gives the wrench of a hand at the beam's end."""
    angle = rounded(math.degrees(goal[2]), MOST_DIGITS - 2)
    goals = [rounded(one, MOST_DIGITS) for one in goal[:2]]
    return line("reach", model, "--goal", *goals, "--goal-angle-deg", angle, "--moment")


def learn_line(recordings: Sequence[str], validate: Sequence[str], out: str, replace: bool) -> str:
    """What learns the same."""
    checks = [word for one in validate for word in ("--validate", one)]
    return line("learn", *recordings, "--output", out, *checks, *(["--force"] if replace else []))


def check_line(name: str) -> str:
    """What checks the same."""
    return line("check", plain_word(name), "--output", f"{plain_word(name)}/check.png")


def loop_line(wanted: Mapping[str, Any]) -> str:
    """What rehearses the same; `wanted` as from `rehearsing.wanted_work`."""
    places = [] if wanted["push_s"] == 1.0 else ["--push-at", number(wanted["push_s"])]
    places += [] if wanted["point_s"] == 1.0 else ["--point", number(wanted["point_s"])]
    beams = ["--draws", str(wanted["draws"])] if wanted["draws"] else ["--k-error", number(wanted["k_error"])]
    bound = [] if wanted["max_force_N"] is None else ["--max-force-N", number(wanted["max_force_N"])]
    timing = ["--delay-ms", number(wanted["delay_ms"]), "--fps", number(wanted["fps"])]
    timing += ["--noise-mm", number(wanted["noise_mm"]), "--duration-s", number(wanted["duration_s"])]
    goal = [number(one) for one in wanted["goal_m"]]
    return line("loop", plain_word(wanted["model"]), "--goal", *goal, *places, *beams, *timing, *bound)


def plain_word(name: str) -> str:
    """A name that no command takes for an option."""
    return f"./{name}" if name.startswith("-") else name


def record_line(wanted: Mapping[str, Any]) -> str:
    """What records the same; `wanted` as from `filming.wanted_recording`."""
    given = [(f"--{key}", wanted[key]) for key in ("camera", "force", "like") if wanted[key]]
    if wanted["until_percent"] is not None:
        given.append(("--until", f"{number(wanted['until_percent'])}%"))
    given += [] if wanted["longest_s"] == 600.0 else [("--longest-s", number(wanted["longest_s"]))]
    given += [] if wanted["crf"] == 18 else [("--crf", str(wanted["crf"]))]
    flags = [f"--{key.replace('_', '-')}" for key in ("now", "no_learning", "fast", "overwrite") if wanted[key]]
    return line("record", wanted["out"], *(word for pair in given for word in pair), *flags)
