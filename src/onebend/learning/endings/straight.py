"""When a contact ends that no swing follows: the beam's bending goes to zero then, with a jump, a kink or smoothly.

As the force in `sensing.edges`: of the time `u` left to the end, `j + v u + a u^2 / 2 + w(u)`, w white noise integrated
twice over u, or `c u^3 / 3 + w(u)`, integrated four times: a hand that leads the beam back as smoothly as it can (least
jerk) ends with the third power, and what comes before it is as smooth. The bending is known without
the force along the beam, about which a straight beam tells nothing.
"""

from __future__ import annotations

from itertools import product
from math import factorial

import numpy as np

from onebend.learning.endings.edge import RUN, Edge
from onebend.learning.endings.evidence import evidence_of, scanned
from onebend.records import Array

_BEFORE, _AFTER = 24, 48  # frames before the last one of the contact, and after it
_LATER = 5  # frames that show a force, and still may be from after the end
_PLACES = (48, 48, 48)  # times that are tried, and again where it is likely
_CLEAR = 10.0  # sds of the noise: a smaller bending tells no end
_REST = 3.0  # sds of the noise: of what rest differs by before the contact and after it
_FINEST = 1e-3  # of the largest bending: what the steps of w leave out
_STEPS = 24  # of w
_LAST = (3e-3, 3e-2, 0.3, 1.0)  # w's sd at the first frame
_ROUGH, _SMOOTH = 2, 4  # times that it is integrated
# Of a jump, of the first, second and third power, and of both w.
_SIZES = (
    *((jump, kink, 2.0, 0.0, last, 0.0) for jump, kink, last in product((0.0, 1.0), (0.0, 1.0), _LAST)),
    *((0.0, 0.0, 0.0, 3.0, 0.0, last) for last in _LAST[:-1]),
)


def straight(time: Array, value: Array, noise: float, first: int, last: int) -> Edge | None:
    """End of the contact of frames `first` to `last` of (T,); None where the bending does not show one. `value` is zero
    at rest, with an sd of `noise` in a frame."""
    early, late = max((first + last + 1) // 2, last - _BEFORE + 1), min(len(time), last + _AFTER + 1)
    early = min(early, last - RUN + 1)
    if late <= last + 1 or early < 0 or float(np.max(np.abs(value[early:late]))) < _CLEAR * noise:
        return None
    long, size = float(time[last] - time[early]), float(np.max(np.abs(value[early:late])))
    time, value, noise = time[early:late], value[early:late], max(noise, _FINEST * size)
    sds = [(0.0, _sds(size, _REST * noise, *one)) for one in _SIZES]

    def evidence(ends: Array) -> Array:
        left = np.maximum(ends[:, None] - time, 0.0) / long
        return evidence_of(_columns(left), value, np.full(len(time), noise), sds)

    low = float(time[max(last - early - _LATER, 0)])
    mean, sd, _ = scanned(evidence, low, float(time[-1]), _PLACES)
    return Edge(mean, sd)


def _columns(left: Array) -> Array:
    """(n, F, 4 + 2 x 24 + 1): powers, both w, and the value at rest."""
    powers = np.stack([(left > 0.0).astype(float), left, left**2 / 2.0, left**3 / 3.0], axis=-1)
    edges = np.concatenate([[0.0], np.geomspace(0.02, 1.5, _STEPS)])
    walks = []
    for times in (_ROUGH, _SMOOTH):
        reach = np.maximum(left[..., None] - edges, 0.0) ** times / factorial(times)
        one = factorial(times - 1) * np.sqrt(2.0 * times - 1.0)  # of variance one at u = 1
        walks.append((reach[..., :-1] - reach[..., 1:]) / np.sqrt(np.diff(edges)) * one)
    return np.concatenate([powers, *walks, np.ones((*left.shape, 1))], axis=-1)


def _sds(
    size: float, rest: float, jump: float, kink: float, square: float, cube: float, rough: float, smooth: float
) -> Array:
    walks = np.repeat([rough, smooth], _STEPS)
    return np.concatenate([size * np.array([jump, kink, square, cube]), size * walks, [rest]])
