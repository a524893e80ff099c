"""Text logs of Franka robots: which columns hold the force, and what to write in recording.toml."""

from __future__ import annotations

import re
from collections.abc import Sequence

# libfranka's own log of the last commands (franka::logToCSV): joints and commands, no force.
JOINTS_ONLY = "state.tau_ext_hat_filtered[0]"
# O_F_ext_hat_K[0], field.O_F_ext_hat_K0, state.K_F_ext_hat_K_0, .../wrench/force/x, field.wrench.force.x, ...
ESTIMATE = re.compile(r"^(?:.*[./ ])?([OK]_F_ext_hat_K)[\[_.]?(\d)\]?$", re.IGNORECASE)
VECTOR = re.compile(r"^(.*force[./_ ]?)([xyz])$", re.IGNORECASE)
TIMES = {"%time": "ns", "field.header.stamp": "ns", "time": "ms", "timestamp": "", "stamp": "", "t": "", "__time": "s"}


def hint(header: Sequence[str]) -> str:
    """What to write in [force] where the header of a text log is one of a robot's; "" where it is not."""
    if JOINTS_ONLY in header and not any(ESTIMATE.match(name) for name in header):
        return (
            " This is libfranka's log of the last commands: it holds the joints' torques and no force. Log "
            "O_F_ext_hat_K of the robot's state, or record a bag."
        )
    forces = likely_forces(header)
    time = next((name for name in header if name.lower() in TIMES), None)
    if forces is None or time is None:
        return ""
    unit = TIMES[time.lower()]
    units = {"": "", "ms": ' and, as libfranka counts in milliseconds, time_unit = "ms"', "s": ""}
    unit_hint = units.get(unit, f' and time_unit = "{unit}"')
    return f' For x and y of this log: columns = ["{time}", "{forces[0]}", "{forces[1]}"]{unit_hint}.'


def likely_forces(header: Sequence[str]) -> tuple[str, str] | None:
    """The columns of the force along x and y, the base's axes before the tool's."""
    sets: dict[str, dict[str, str]] = {}
    for name in header:
        if match := ESTIMATE.match(name):
            sets.setdefault("0" if match[1][0] in "Oo" else "1", {})[match[2]] = name
        elif match := VECTOR.match(name):
            sets.setdefault(f"2{match[1]}", {})[str("xyz".index(match[2].lower()))] = name
    for _, columns in sorted(sets.items()):
        if "0" in columns and "1" in columns:
            return columns["0"], columns["1"]
    return None
