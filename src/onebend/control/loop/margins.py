"""Stability margins of the sampled loop: gain, phase, delay, and the error of k that it tolerates.

Every frame at `t_k = k / fps` the controller takes what the camera saw `delay` earlier, filters the error and adds it
to the integral, and the force is held to the next frame:

    f_k = a f_(k-1) + (1 - a) e_k,    g_k = a g_(k-1) + (1 - a) f_k,    a = exp(-corner / fps)
    u_k = u_(k-1) + (rate / fps) C^+ g_k

With the plant of `plant.py` this is one linear recursion, whose largest eigenvalue decides (`SampledLoop.radius`), and
whose characteristic loci (the eigenvalues of the 2 x 2 loop transfer on the unit circle) give the phase margin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from onebend.control.loop.plant import Plant, behind_actuator
from onebend.errors import ControlError
from onebend.records import Array

ComplexArray = NDArray[np.complex128]

_FREQUENCIES = 600
_SCAN_RATIO = 1.04  # of a scan for the onset of instability
_MOST_SCAN_STEPS = 200  # steps of it


@dataclass(frozen=True)
class Timing:
    """The loop's clock: what lies between a position and the force that answers it."""

    fps: float = 30.0  # 1/s
    delay: float = 0.05  # s, from exposure to the force that answers it
    lag: float = 0.02  # s, time constant of the actuator

    def __post_init__(self) -> None:
        known = np.isfinite([self.fps, self.delay, self.lag])
        if not np.all(known) or not (self.fps > 0.0 and self.delay >= 0.0 and self.lag >= 0.0):
            raise ControlError(
                f"a loop needs a frame rate above zero, a delay and a lag that are not negative, got "
                f"{self.fps:g} 1/s, {self.delay:g} s and {self.lag:g} s"
            )


@dataclass(frozen=True)
class Gains:
    """The integral's rate, and the corner of the two equal filters before it."""

    rate: float  # 1/s: the error falls as exp(-rate t) where all is as modelled and slow
    corner: float  # rad/s

    def __post_init__(self) -> None:
        if not (np.isfinite([self.rate, self.corner]).all() and self.rate > 0.0 and self.corner > 0.0):
            raise ControlError(f"gains must be finite and positive, got {self.rate:g} and {self.corner:g}")


@dataclass(frozen=True)
class SampledLoop:
    """One sampled loop: a plant, and a controller whose map from error to force is `inverse`."""

    plant: Plant
    inverse: Array  # (2, 2) N/m: C^+
    gains: Gains
    timing: Timing

    def matrix(self) -> Array:
        """(M, M): the closed loop from one frame to the next."""
        linear, frame = behind_actuator(self.plant, self.timing.lag), 1.0 / self.timing.fps
        whole, part = _split(self.timing)
        (a, b), (a_seen, b_seen) = linear.over(frame), linear.over((1.0 - part) * frame)
        keep, n = float(np.exp(-self.gains.corner * frame)), len(linear.a)
        eye = np.eye(n + 2 * (whole + 4))
        state, late = eye[:n], eye[n : n + 2 * whole]  # what the camera saw and has not delivered yet, then the oldest
        arrived, f, g, u = np.split(eye[n + 2 * whole :], 4)
        f = keep * f - (1.0 - keep) * arrived
        g = keep * g + (1.0 - keep) * f
        u = u + self.gains.rate * frame * self.inverse @ g
        seen = linear.c @ (a_seen @ state + b_seen @ u)
        return np.vstack([a @ state + b @ u, seen, late, f, g, u])

    @property
    def radius(self) -> float:
        """Largest size of an eigenvalue: the loop is stable where it is below 1."""
        return float(np.max(np.abs(np.linalg.eigvals(self.matrix()))))

    def loci(self, frequency: Array) -> ComplexArray:
        """(R, 2): characteristic loci at frequencies (R,) [rad/s], each a continuous curve."""
        linear, frame = behind_actuator(self.plant, self.timing.lag), 1.0 / self.timing.fps
        whole, part = _split(self.timing)
        (a, b), (a_seen, b_seen) = linear.over(frame), linear.over((1.0 - part) * frame)
        keep = np.exp(-self.gains.corner * frame)
        z = np.exp(1j * frequency * frame)
        inside = np.linalg.solve(z[:, None, None] * np.eye(len(a)) - a, np.broadcast_to(b, (len(z), *b.shape)))
        seen = linear.c @ (a_seen @ inside + b_seen)
        of_error = self.gains.rate * frame * z / (z - 1.0) * ((1.0 - keep) * z / (z - keep)) ** 2
        found = np.linalg.eigvals((of_error * z ** -(whole + 1.0))[:, None, None] * (seen @ self.inverse))
        before, here = found[:-1], found[1:]
        crossed = np.sum(np.abs(here - before), axis=1) > np.sum(np.abs(here[:, ::-1] - before), axis=1)
        swapped = np.append(False, np.cumsum(crossed) % 2 == 1)
        return np.where(swapped[:, None], found[:, ::-1], found)


@dataclass(frozen=True)
class Margins:
    """How far a loop is from instability. Infinite: no onset found within a factor of 2500."""

    gain: float  # factor on the loop's gain
    phase: float  # rad, lag in all directions alike; infinite where the gain never reaches 1
    delay: float  # s, in addition to the loop's own
    softest: float  # k may be this share of the model's everywhere, the shape of k(s) being right; below it rings
    radius: float  # of the loop itself; the rest is 0 or NaN where it is not below 1

    @property
    def stable(self) -> bool:
        return self.radius < 1.0


def margins(loop: SampledLoop) -> Margins:
    """The margins of a sampled loop."""
    radius = loop.radius
    if not radius < 1.0:
        return Margins(0.0, 0.0, 0.0, np.nan, radius)

    def stiffer(factor: float) -> SampledLoop:
        return replace(loop, plant=loop.plant.stiffer(1.0 / factor))

    def later(extra: float) -> SampledLoop:
        return replace(loop, timing=replace(loop.timing, delay=loop.timing.delay + extra - _SHORTEST_DELAY))

    return Margins(
        gain=onset(lambda g: replace(loop, gains=replace(loop.gains, rate=g * loop.gains.rate))),
        phase=phase_margin(loop),
        delay=onset(later, first=_SHORTEST_DELAY) - _SHORTEST_DELAY,
        softest=1.0 / onset(stiffer),
        radius=radius,
    )


_SHORTEST_DELAY = 0.01  # s: delays are scanned from here in equal ratios


def onset(of: Callable[[float], SampledLoop], *, first: float = 1.0) -> float:
    """The smallest number above `first` at which the loop `of` it is unstable; to 1e-4 of it."""
    low = first
    for _ in range(_MOST_SCAN_STEPS):
        high = low * _SCAN_RATIO
        if of(high).radius >= 1.0:
            while high - low > 1e-4 * low:
                middle = 0.5 * (low + high)
                low, high = (low, middle) if of(middle).radius >= 1.0 else (middle, high)
            return 0.5 * (low + high)
        low = high
    return np.inf


def phase_margin(loop: SampledLoop) -> float:
    """rad: the least further lag, in all directions alike, at which a locus meets -1."""
    loci = loop.loci(frequencies(loop.timing))
    return min((_least_lag(curve) for curve in loci.T), default=np.inf)


def frequencies(timing: Timing) -> Array:
    """rad/s: from far below the loop's rate to half the frame rate."""
    return np.geomspace(1e-4, 1.0, _FREQUENCIES) * np.pi * timing.fps


def _least_lag(curve: ComplexArray) -> float:
    size, angle = np.log(np.abs(curve)), np.unwrap(np.angle(curve))
    at = np.flatnonzero(size[:-1] * size[1:] < 0.0)
    share = size[at] / (size[at] - size[at + 1])
    lags = np.mod(angle[at] + share * (angle[at + 1] - angle[at]) + np.pi, 2.0 * np.pi)
    return float(np.min(lags, initial=np.inf))


def _split(timing: Timing) -> tuple[int, float]:
    """The delay in frames: whole ones, and the rest in [0, 1)."""
    frames = timing.delay * timing.fps
    whole = int(np.floor(frames + 1e-9))
    return whole, max(frames - whole, 0.0)
