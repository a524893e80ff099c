"""Natural frequencies in the fit: measured ones, what the parameters predict, and where the fit may begin."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import brentq

from onebend.beam.dynamics import Actions, Body, body_of_nodes
from onebend.beam.grid import Grid, make_grid
from onebend.beam.model import Beam
from onebend.beam.stiffness import RectangularSection, Scaled, Uniform
from onebend.beam.vibration import Vibration, frequency_slopes, natural_frequencies, settle, shear_share, vibration_of
from onebend.errors import LearningError, MechanicsError
from onebend.learning.allowances import patch_functions
from onebend.learning.fit_data import MASS_MODES, POWERS, REST_MODES, OwnWeight, own_weight
from onebend.learning.frames import mass_profile
from onebend.learning.outcome import Notice
from onebend.learning.parameters import NEEDS_MASS, Layout, Spline
from onebend.records import Array, IntArray, MeasuredFrequency, Observations, PointMass, tags_among

_ORDER, _WIDEST = 6, 0.125  # as the statics of the fit: 1e-7 in the frequencies of the first modes


@dataclass(frozen=True)
class Posture:
    """Frequencies that were measured with the base held alike and the same mass at the tip."""

    gravity: Array  # (2,) m/s^2 in the beam's frame
    points: tuple[PointMass, ...]
    rows: IntArray  # (n,) which of the recording's frequencies
    modes: IntArray  # (n,) of each, counted from 0


@dataclass(frozen=True)
class FrequencyData:
    """N frequencies; Q nodes of a grid."""

    name: str  # of the recording
    number: int  # of the same, among those that are fitted together
    measured: Array  # (N,) log of Hz
    sd: Array  # (N,) of the logs
    postures: tuple[Posture, ...]
    length: float  # m, as written
    grid: Grid
    on_nodes: Array  # (Q, p): the spline's functions
    patches: Array | None  # (Q, n): functions of log k under the tags
    rest_on_nodes: Array  # (Q, 3)
    mass: OwnWeight
    written: Array  # (Q,) kg/m that the parts of the mass come on top of
    section: RectangularSection | None  # from which shear and rotary inertia follow; None where it is not stated


def frequency_data(recordings: Sequence[Observations], spline: Spline) -> tuple[FrequencyData, ...]:
    """The frequencies of the recordings that have some. Raises `LearningError` without a mass."""
    return tuple(_prepared(o, i, spline) for i, o in enumerate(recordings) if o.frequencies)


def _prepared(o: Observations, number: int, spline: Spline) -> FrequencyData:
    if not np.isfinite(o.stated.mass):
        raise LearningError(f"{o.source.name}: {NEEDS_MASS}")
    grid = make_grid(order=_ORDER, widest=_WIDEST)
    nodes, line = grid.nodes, mass_profile(o)
    written = line if o.stated.mass_along not in POWERS else Uniform(0.0)
    measured = np.array([one.frequency for one in o.frequencies])
    glued = not o.static and np.isfinite(o.stated.tag_size) and bool(np.any(tags_among(o)))
    return FrequencyData(
        name=o.source.name,
        number=number,
        measured=np.log(measured),
        sd=np.array([one.sd for one in o.frequencies]) / measured,
        postures=postures_of(o.frequencies, o.stated.masses),
        length=o.length,
        grid=grid,
        on_nodes=spline.basis(nodes),
        patches=patch_functions(o.marker_s[tags_among(o)], o.length, o.stated.tag_size, nodes) if glued else None,
        rest_on_nodes=REST_MODES.curvature(nodes),
        mass=own_weight(o, grid, np.zeros((1, 2)), MASS_MODES.curvature(nodes), line),
        written=np.asarray(written(nodes)),
        section=RectangularSection(o.stated.thickness) if np.isfinite(o.stated.thickness) else None,
    )


def postures_of(frequencies: tuple[MeasuredFrequency, ...], riding: tuple[PointMass, ...] = ()) -> tuple[Posture, ...]:
    """The frequencies by posture and mass at the tip; `riding` masses are on the beam in all of them."""
    found: dict[tuple[tuple[float, ...], float], list[int]] = {}
    for i, one in enumerate(frequencies):
        found.setdefault((one.gravity, one.tip_mass), []).append(i)
    return tuple(
        Posture(
            np.array(gravity),
            (*riding, PointMass(1.0, tip)) if tip > 0.0 else riding,
            np.array(rows, dtype=np.int64),
            np.array([frequencies[i].mode - 1 for i in rows], dtype=np.int64),
        )
        for (gravity, tip), rows in found.items()
    )


@dataclass(frozen=True)
class PredictedFrequencies:
    """The frequencies of one recording's beam at parameters x (P,)."""

    data: FrequencyData
    layout: Layout
    x: Array
    vibrations: tuple[Vibration | None, ...]  # of each posture; None where the beam does not stand

    @cached_property
    def log(self) -> Array:
        """(N,) of Hz; NaN where the beam does not stand."""
        out = np.full(len(self.data.measured), np.nan)
        for posture, found in zip(self.data.postures, self.vibrations, strict=True):
            if found is not None:
                out[posture.rows] = np.log(found.frequency[posture.modes]) - 0.5 * np.log1p(self._shear(found, posture))
        return out

    def _shear(self, found: Vibration, posture: Posture) -> Array:
        """(n,) by which shear lowers the squares of the posture's frequencies."""
        data = self.data
        if data.section is None:
            return np.zeros(len(posture.modes))
        k = np.diag(found.body.stiffness) / data.grid.weights
        compliance = data.section.compliance(k, data.grid.weights, np.array(found.body.length))[1]
        return shear_share(found, compliance, posture.modes.tolist())

    @property
    def residuals(self) -> Array:
        """(N,) measured less predicted, over its sd."""
        return np.asarray((self.data.measured - self.log) / self.data.sd)

    @cached_property
    def slopes(self) -> Array:
        """(N, P) derivatives of `log` with all parameters; the small ones of shear and rotary inertia are left out."""
        data, layout, x = self.data, self.layout, self.x
        out = np.zeros((len(data.measured), layout.size))
        k, parts = _stiffness(data, layout, x), layout.get(x, "mass")
        by_mass = data.mass.line_by_mass(k)
        carried = data.mass.line_by_stiffness(k, np.eye(len(k)), parts)  # (Q, Q): where the mass follows k(s)
        for posture, found in zip(data.postures, self.vibrations, strict=True):
            if found is None:
                continue
            by = frequency_slopes(found, posture.gravity, posture.modes.tolist())
            log_k = by.log_k if carried is None else by.log_k + by.mass_per_length @ carried
            blocks = {
                "stiffness": log_k @ data.on_nodes,
                "curvature": by.rest_curvature @ data.rest_on_nodes,
                "mass": by.mass_per_length @ by_mass,
                "length": by.log_length[:, None],
            }
            if data.patches is not None:
                blocks["patches"] = log_k @ data.patches
            for name, slopes in blocks.items():
                block = layout.index.get((name, -1))
                if block is not None and block.start >= 0:
                    out[posture.rows, block.where] = slopes
        return out


def predicted_frequencies(data: FrequencyData, layout: Layout, x: Array) -> PredictedFrequencies:
    """Vibrations about rest in every posture."""
    k = _stiffness(data, layout, x)
    line = data.written + data.mass.line(k, layout.get(x, "mass"))
    log_length = float(layout.get(x, "length")[0]) if ("length", -1) in layout.index else 0.0
    rest = data.rest_on_nodes @ layout.get(x, "curvature")
    length = data.length * np.exp(log_length)
    line, thick = np.exp(-log_length) * line, 0.0 if data.section is None else float(data.section.thickness)
    iota = line * thick**2 / 12.0
    bodies = [
        body_of_nodes(data.grid, length, k, line, rest, rotary_inertia=iota, points=posture.points)
        for posture in data.postures
    ]
    return PredictedFrequencies(data, layout, x, tuple(map(_vibration, bodies, data.postures)))


def _stiffness(data: FrequencyData, layout: Layout, x: Array) -> Array:
    """(Q,) N m."""
    log_k = data.on_nodes @ layout.get(x, "stiffness")
    if data.patches is not None and ("patches", -1) in layout.index:
        log_k = log_k + data.patches @ layout.get(x, "patches")
    return np.asarray(np.exp(log_k))


def _vibration(on: Body, posture: Posture) -> Vibration | None:
    if not on.mass > 0.0:
        return None
    actions, count = Actions(gravity=posture.gravity), int(np.max(posture.modes)) + 1
    for steps in (1, 10):
        try:
            return vibration_of(on, settle(on, actions, load_steps=steps), actions, count=count)
        except (MechanicsError, np.linalg.LinAlgError):
            continue
    return None


FAR, GROSS = 3.0, 6.0  # sd: a frequency is odd if it is this far from the fit; k(s) is not to be trusted if so far


@dataclass(frozen=True)
class ComparedFrequency:
    """One frequency as measured and as fitted."""

    recording: str
    mode: int  # 1 is the slowest
    posture: Posture
    measured: float  # Hz, undamped
    sd: float  # Hz
    fitted: float  # Hz

    @property
    def off(self) -> float:
        """Measured less fitted, in sd."""
        return (self.measured - self.fitted) / self.sd


def compared_frequencies(predicted: Sequence[PredictedFrequencies]) -> tuple[ComparedFrequency, ...]:
    """All frequencies, by recording and posture."""
    out = []
    for one in predicted:
        measured, fitted = np.exp(one.data.measured), np.exp(one.log)
        for posture in one.data.postures:
            for row, mode in zip(posture.rows.tolist(), posture.modes.tolist(), strict=True):
                hz, sd = float(measured[row]), float(measured[row] * one.data.sd[row])
                out.append(ComparedFrequency(one.data.name, mode + 1, posture, hz, sd, float(fitted[row])))
    return tuple(out)


def validated_frequencies(beam: Beam, o: Observations) -> tuple[Notice, ...]:
    """A note on the natural frequencies of a beam with a mass beside those that were measured."""
    rows = []
    for posture in postures_of(o.frequencies, () if beam.masses else o.stated.masses):
        count = int(np.max(posture.modes)) + 1
        own = natural_frequencies(beam, gravity=posture.gravity, points=posture.points, count=count)
        for row, mode in zip(posture.rows.tolist(), posture.modes.tolist(), strict=True):
            one = o.frequencies[row]
            rows.append(ComparedFrequency(o.source.name, mode + 1, posture, one.frequency, one.sd, float(own[mode])))
    return (Notice("validated frequencies", {"rows": tuple(rows)}),) if rows else ()


def frequency_notices(predicted: Sequence[PredictedFrequencies]) -> tuple[Notice, ...]:
    """A note with all frequencies, and a warning on those that the fit does not follow."""
    rows = compared_frequencies(predicted)
    odd = tuple(row for row in rows if not abs(row.off) < FAR)
    note = (Notice("fitted frequencies", {"rows": rows}),) if rows else ()
    return (*note, *((Notice("odd frequencies", {"rows": odd}),) if odd else ()))


def worst_off(predicted: Sequence[PredictedFrequencies]) -> float:
    """sd, of the frequency farthest from the fit; NaN if none was measured."""
    return max((abs(row.off) for row in compared_frequencies(predicted)), default=math.nan)


# The uniform beam with a given frequency, and the mass of a known beam.

_STIFF = 100.0  # times as stiff as a beam without weight: there weight changes the square of a frequency linearly
_LEAST = 0.05  # of the stiffness without weight: less would be a beam near buckling
_MASSES = (1e-9, 1e3)  # kg, within which one is looked for


def uniform_stiffness(o: Observations, measured: MeasuredFrequency, mode: int, mass: float = np.nan) -> float:
    """N m: k of the uniform beam whose `mode` (from 1) has this frequency, with the recording's mass or `mass` kg. `f^2
    = a k + b`, with b from the weight: exact for small weights."""
    along, known = mass_profile(o), np.isfinite(mass)
    if not np.isfinite(o.stated.mass):
        along = Uniform((mass if known else 1.0) / o.length)
    elif known:
        along = Scaled(mass / o.stated.mass, along)
    points = [*o.stated.masses, PointMass(1.0, measured.tip_mass)]
    beam = Beam(o.length, Uniform(1.0), mass_per_length=along)
    by_k = float(natural_frequencies(beam, points=points, count=mode)[-1]) ** 2
    light = measured.frequency**2 / by_k
    if not np.any(measured.gravity):
        return light
    weight = float(np.linalg.norm(measured.gravity)) * (_total(beam) + sum(point.mass for point in points))
    stiff = _STIFF * max(light, weight * o.length)
    straight = replace(beam, stiffness=Uniform(stiff))
    found = float(natural_frequencies(straight, gravity=measured.gravity, points=points, count=mode)[-1]) ** 2
    return max(light - (found / by_k - stiff), _LEAST * light)


def _total(beam: Beam) -> float:
    """kg."""
    s = np.linspace(0.0, 1.0, 101)
    return beam.length * float(np.trapezoid(beam.mass_per_length(s), s))


def stiffness_level(recordings: Sequence[Observations]) -> float:
    """N m, median over all frequencies of a beam whose mass is known or guessed."""
    each = [uniform_stiffness(o, one, one.mode) for o in recordings for one in o.frequencies]
    return float(np.exp(np.median(np.log(each))))


def swinging_mass(recordings: Sequence[Observations], stiffness: float) -> float:
    """kg, of a uniform beam of this k [N m] that swings as its slowest frequency says; at least a trace."""
    o, slowest = min(
        ((o, one) for o in recordings for one in o.frequencies), key=lambda pair: (pair[1].mode, pair[1].frequency)
    )

    def too_stiff(log_mass: float) -> float:
        return float(np.log(uniform_stiffness(o, slowest, slowest.mode, float(np.exp(log_mass))) / stiffness))

    low, high = np.log(_MASSES)
    if too_stiff(low) >= 0.0:
        return _MASSES[0]
    return float(np.exp(brentq(too_stiff, low, high, xtol=1e-3))) if too_stiff(high) > 0.0 else _MASSES[1]
