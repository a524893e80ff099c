"""A profile in polynomial pieces: any smooth function between given places, to machine precision, jumps kept.

Sections of tapered and layered beams give k(s), mass and curvature as functions that are smooth between jumps but of
no named family. Legendre pieces hold them as plain numbers, and evaluate fast.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from onebend.errors import MechanicsError
from onebend.records import Array

_DEGREE = 15
_NARROWEST = 2.0**-12  # in s: a piece is not cut further


@dataclass(frozen=True)
class Pieces:
    """On each piece between `edges` a Legendre series of the given degree, in x from -1 to 1 across the piece."""

    edges: tuple[float, ...]  # rising from 0 to 1
    degree: int
    coefficients: tuple[float, ...]  # (P * (degree + 1),), piece after piece
    jumps: tuple[float, ...] = ()  # those edges where the profile or its slope is not continuous

    def __post_init__(self) -> None:
        if len(self.edges) < 2 or self.edges[0] != 0.0 or self.edges[-1] != 1.0 or np.any(np.diff(self.edges) <= 0.0):
            raise MechanicsError("the edges of pieces must rise from 0 to 1")
        if self.degree < 0 or len(self.coefficients) != (len(self.edges) - 1) * (self.degree + 1):
            raise MechanicsError(
                f"{len(self.edges) - 1} pieces of degree {self.degree} need "
                f"{(len(self.edges) - 1) * (self.degree + 1)} coefficients, got {len(self.coefficients)}"
            )
        if not set(self.jumps) <= set(self.edges[1:-1]):
            raise MechanicsError("pieces can jump at their inner edges only")

    def __call__(self, s: Array | float) -> Array:
        places, edges = np.asarray(s, dtype=float), np.asarray(self.edges)
        piece = np.searchsorted(edges[1:-1], places, side="right")
        x = 2.0 * (places - edges[piece]) / np.diff(edges)[piece] - 1.0
        series = np.asarray(self.coefficients).reshape(-1, self.degree + 1)
        values = np.sum(np.polynomial.legendre.legvander(x, self.degree) * series[piece], axis=-1)
        return np.asarray(values).reshape(places.shape)

    def as_dict(self) -> dict[str, Any]:
        return {
            "kind": "pieces",
            "edges": list(self.edges),
            "degree": self.degree,
            "coefficients": list(self.coefficients),
            "jumps": list(self.jumps),
        }


def taper(first: float, last: float) -> Pieces:
    """A profile that runs in a straight line from `first` at the base to `last` at the tip."""
    return Pieces((0.0, 1.0), 1, (0.5 * (first + last), 0.5 * (last - first)))


def broken_line(s: tuple[float, ...], values: tuple[float, ...]) -> Pieces:
    """Straight lines through values at places from 0 to 1; a place given twice is a jump from one value to the next.

    Raises:
        MechanicsError: places that do not run from 0 to 1, or not one value a place.
    """
    if len(s) != len(values) or len(s) < 2:
        raise MechanicsError(f"a broken line needs one value a place, got {len(s)} places and {len(values)} values")
    pairs = list(zip(s, values, strict=True))
    lines = [(a, b) for a, b in pairwise(pairs) if b[0] != a[0]]
    edges = (lines[0][0][0], *(end[0] for _, end in lines))
    flat = [c for (_, u), (_, v) in lines for c in (0.5 * (u + v), 0.5 * (v - u))]
    return Pieces(edges, 1, tuple(flat), edges[1:-1])


def in_pieces(
    function: Callable[[Array], Array],
    breaks: tuple[float, ...] = (),
    *,
    jumps: tuple[float, ...] = (),
    tolerance: float = 1e-12,
) -> Pieces:
    """The pieces of a function of s, cut at `breaks` and `jumps`, and halved until each is resolved to `tolerance`.

    `tolerance` is a share of the largest value. `jumps` are the places where the value or slope may jump.

    Raises:
        MechanicsError: values that are not finite, or a piece that halving does not resolve (a jump not listed).
    """
    inner = sorted({b for b in (*breaks, *jumps) if 0.0 < b < 1.0})
    x = np.polynomial.legendre.leggauss(_DEGREE + 1)[0]
    to_series = np.linalg.inv(np.polynomial.legendre.legvander(x, _DEGREE))
    stops, edges, rows = [*inner, 1.0], [0.0], []
    scale = float(np.max(np.abs(function(np.linspace(0.0, 1.0, 101)))))
    while stops:
        a, b = edges[-1], stops[0]
        values = function(0.5 * (a + b) + 0.5 * (b - a) * x)
        if not np.all(np.isfinite(values)):
            raise MechanicsError(f"the profile is not finite between s = {a:.6g} and {b:.6g}")
        row = to_series @ values
        if np.max(np.abs(row[-2:])) <= tolerance * scale:
            edges.append(stops.pop(0))
            rows.append(row)
        elif b - a > _NARROWEST:
            stops.insert(0, 0.5 * (a + b))
        else:
            raise MechanicsError(f"the profile jumps near s = {a:.4f}: give that place as a break")
    return Pieces(tuple(edges), _DEGREE, tuple(np.concatenate(rows).tolist()), tuple(j for j in inner if j in jumps))
