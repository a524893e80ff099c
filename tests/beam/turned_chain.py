"""A heavy cable on a base that is slowly turned, as a fine chain of rigid links with springs between them: nothing of
`onebend.beam` is in it. It is let down its energy at every small step, so it takes the way that a real cable takes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import cholesky_banded, solveh_banded

from onebend.records import Array

G = 9.81
_STEP = 1.0  # deg, of the base, at most
_TURN = 0.1  # rad, of a link in one step down the energy
_SETTLED = 1e-9  # rad


@dataclass(frozen=True)
class Cable:
    """With a bending stiffness EI(s) [N m^2], `line` [kg/m] and a mass at its tip [kg]."""

    length: float
    bending: Callable[[Array], Array]
    line: float
    tip: float = 0.0

    def k(self, s: Array) -> Array:
        """N m, EI / L."""
        return self.bending(s) / self.length


@dataclass(frozen=True)
class Chain:
    """The cable as n links; a spring at the clamp is half as long as the others."""

    cable: Cable
    links: int = 800

    @property
    def springs(self) -> Array:
        """(n,) N m/rad."""
        stiff = self.cable.bending(np.arange(self.links) / self.links) * self.links / self.cable.length
        stiff[0] *= 2.0
        return np.asarray(stiff)

    @property
    def levers(self) -> Array:
        """(n,) N m: the weight beyond the middle of each link, times the link."""
        beyond = 1.0 - (np.arange(self.links) + 0.5) / self.links
        cable = self.cable
        return np.asarray(G * (cable.line * cable.length * beyond + cable.tip) * cable.length / self.links)

    def energy(self, angle: Array, base: float) -> float:
        """J, of links at angles (n,) [rad] in the room."""
        bend = np.diff(angle, prepend=base)
        return float(0.5 * np.sum(self.springs * bend**2) + np.sum(self.levers * np.sin(angle)))

    def let_down(self, angle: Array, base: float) -> Array:
        """From angles (n,) down to a minimum of the energy: Newton's steps, made downhill and short."""
        springs, levers, diagonal = self.springs, self.levers, np.zeros((2, self.links))
        diagonal[0, 1:] = -springs[1:]
        for _ in range(5000):
            moment = springs * np.diff(angle, prepend=base)
            slope = moment - np.append(moment[1:], 0.0) + levers * np.cos(angle)
            stiff, shift = springs + np.append(springs[1:], 0.0) - levers * np.sin(angle), 0.0
            while True:
                diagonal[1] = stiff + shift * springs
                try:
                    cholesky_banded(diagonal)
                    break
                except np.linalg.LinAlgError:
                    shift = max(2.0 * shift, 1e-4)
            step = -solveh_banded(diagonal, slope)
            largest = float(np.max(np.abs(step)))
            if largest < _SETTLED and shift == 0.0:
                return angle
            share, here = min(1.0, _TURN / max(largest, 1e-300)), self.energy(angle, base)
            while self.energy(angle + share * step, base) > here + 1e-14 * abs(here) and share > 1e-9:
                share *= 0.5
            angle = angle + share * step
        raise AssertionError("the chain does not come to rest")

    def turned(self, degrees: Sequence[float], start: Array | None = None) -> Array:
        """(N, n) rad in the room, at rest while the base is turned from the first angle to the last; `start`: there."""
        base = np.radians(degrees[0])
        angle = self.let_down(np.full(self.links, base) if start is None else start, base)
        out = [angle]
        for a, b in pairwise(degrees):
            for way in np.linspace(a, b, int(np.ceil(abs(b - a) / _STEP)) + 1)[1:]:
                angle = self.let_down(angle, float(np.radians(way)))
            out.append(angle)
        return np.stack(out)

    def points(self, angle: Array, s: Array) -> Array:
        """(..., S, 2) m in the room from the clamp, of links at angles (..., n); `s` at joints."""
        unit = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * self.cable.length / self.links
        joints = np.concatenate([np.zeros_like(unit[..., :1, :]), np.cumsum(unit, axis=-2)], axis=-2)
        return np.asarray(joints[..., np.rint(s * self.links).astype(int), :])
