"""One beam as every target of an export takes it, draws of it, and what a target leaves out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from onebend.beam.model import Beam
from onebend.beam.setup import MOST_REACHED, SetUp
from onebend.beam.stiffness import POISSON, SHAPE_LEVELS, SHAPE_PLACES, LogSpline, Polyline, UncertainStiffness, Uniform
from onebend.errors import ExportError, MechanicsError
from onebend.records import Array, StatedSection

MASSES = (1e-9, 1e6)  # kg, that a beam may have
TIMES = (1e-9, 1e6)  # s, of damping over stiffness
DAMPING_TIME = 0.02  # s, where no swing was filmed
_GRID = np.linspace(0.0, 1.0, 401)
_WEIGHTS = np.r_[0.5, np.ones(399), 0.5] / 400.0


class Relaxing(NamedTuple):
    """A part of the stiffness that relaxes: `M = EI (kappa - sum a kappa_v)` with `tau kappa_v' = kappa - kappa_v`.

    EI is the instantaneous stiffness: `K_inf = EI (1 - sum a)`, and each part's own is `K_1 = a EI`.
    """

    share: float  # a
    time: float  # tau, s


class Request(NamedTuple):
    """How a target is to be written."""

    hinges: int  # of a chain
    notes: tuple[str, ...]  # lines for its head
    samples: tuple[RodSample, ...] = ()  # draws, for the columns of a table


@dataclass(frozen=True)
class RodSample:
    """All of a beam that a target may hold. It is the most probable beam, or a draw."""

    beam: Beam  # k(s), curvature at rest, mass, masses that ride on it; where it has a thickness also EA and kGA
    section: StatedSection | None = None  # from which EA and kGA follow where the beam has no thickness
    relaxation: tuple[Relaxing, ...] = ()
    instantaneous: float = 1.0  # instantaneous stiffness over k(s), which is that of a push like the recorded one
    damping_time: float | None = None  # s, damping over stiffness; None: not known
    damping_sd: float = 0.0  # of its log, from the swing; independent of k(s), whose level the swing's frequency gives
    sites: tuple[float, ...] = ()  # places of the tags
    push: tuple[tuple[float, float], float] | None = None  # the largest recorded force [N] and its place
    uncertain: UncertainStiffness | None = None
    setup: SetUp | None = None  # jointly with k(s): how it stretches, shears and relaxes
    softer: float = 1.0  # factor on the stretch and shear that the stated section gives
    told: tuple[tuple[str, str], ...] = ()  # how it was measured, for people

    def __post_init__(self) -> None:
        if not all(0.0 <= part.share < 1.0 and part.time > 0.0 for part in self.relaxation) or self.relaxed <= 0.0:
            raise ExportError("relaxing shares lie between 0 and 1, together too, and their times are positive")
        if self.damping_time is not None and not TIMES[0] <= self.damping_time <= TIMES[1]:
            raise ExportError(
                f"the damping time must be a positive number of seconds ({TIMES[0]:g} to {TIMES[1]:g}), got "
                f"{self.damping_time}; without damping a chain of light links and stiff hinges rings for ever"
            )

    @property
    def loss_time(self) -> float:
        """s, damping over stiffness, with what stands for it where it is not known."""
        return DAMPING_TIME if self.damping_time is None else self.damping_time

    @property
    def damping_band(self) -> tuple[float, float]:
        """s, the 95 % band of the damping time, which is log-normal."""
        wide = math.exp(1.96 * self.damping_sd)
        return self.loss_time / wide, self.loss_time * wide

    @property
    def relaxed(self) -> float:
        """Stiffness after a long hold over k(s)."""
        return self.instantaneous * (1.0 - sum(part.share for part in self.relaxation))

    @property
    def stretches(self) -> bool:
        """Whether EA and kGA are known."""
        return self.beam.thickness is not None or (self.section is not None and self.section.shape in _GYRATION)

    def stiffness(self, s: Array) -> Array:
        """k at `s` [N m], or an `ExportError` where it is not positive."""
        k = np.asarray(self.beam.stiffness(s))
        if not np.all(k > 0.0):
            raise ExportError(f"k(s) is not positive at s = {s[~(k > 0.0)][0]:.3f}; no simulator can bend such a beam")
        return k

    def mass(self, s: Array) -> Array:
        """Mass per metre at `s` [kg/m], or an `ExportError` where none is known."""
        out = np.asarray(self.beam.mass_per_length(s))
        if not np.all(out > 0.0):
            raise ExportError(
                "the beam's mass is not known, and a simulator in time needs it: weigh the beam and give --mass-kg "
                "(mass in Python), or write mass_kg under [beam] into recording.toml and learn again"
            )
        return out

    def axial(self, s: Array) -> tuple[Array, Array]:
        """EA and kGA at `s` [N]; infinite where neither is known."""
        k, length = self.stiffness(s), self.beam.length
        if self.beam.section is not None:  # a rectangle's thickness depends on the mean of k
            nodes, weights = np.concatenate([_GRID, s.ravel()]), np.concatenate([_WEIGHTS, np.zeros(s.size)])
            give = self.beam.section.compliance(self.stiffness(nodes), weights, np.asarray(length))
            stretch, shear = (1.0 / one[len(_GRID) :].reshape(s.shape) for one in give)
            return stretch, shear
        if self.section is None or self.section.shape not in _GYRATION:
            return np.full(s.shape, np.inf), np.full(s.shape, np.inf)
        sizes = (self.section.thickness, self.section.thickness if self.section.inner is None else self.section.inner)
        outer, inner = (Polyline(tuple(self.section.s.tolist()), tuple(one.tolist()))(s) for one in sizes)
        squared, factor = _GYRATION[self.section.shape](outer, inner)
        stretch = k * length / (self.softer * squared)
        return stretch, factor * stretch / (2.0 * (1.0 + POISSON))


def _round(outer: Array, inner: Array) -> tuple[Array, Array]:
    """Of a tube; Cowper's shear factor (1966)."""
    hole = 1.0 + (inner / outer) ** 2
    shear = 6.0 * (1.0 + POISSON) * hole**2
    return (outer**2 + inner**2) / 16.0, shear / (
        (7.0 + 6.0 * POISSON) * hole**2 + (20.0 + 12.0 * POISSON) * (hole - 1.0)
    )


# I / A [m^2] and the shear factor, from the size in the plane of bending and a hole's
_GYRATION: Mapping[str, Callable[[Array, Array], tuple[Array, Array]]] = {
    "rectangle": lambda h, _: (h**2 / 12.0, np.full(h.shape, 5.0 / 6.0)),
    "circle": lambda d, _: _round(d, np.zeros(d.shape)),
    "tube": _round,
    "hexagon": lambda d, _: (5.0 * d**2 / 72.0, _round(d, np.zeros(d.shape))[1]),
}


def rod_sample(
    beam: Beam,
    *,
    mass: float | None = None,
    damping_time: float | None = None,
    sites: tuple[float, ...] = (),
    section: StatedSection | None = None,
    uncertain: UncertainStiffness | None = None,
) -> RodSample:
    """The sample of a beam. `mass` [kg] is spread evenly along it; None takes the beam's own.

    Raises `ExportError`: a mass or a damping time without meaning.
    """
    if mass is not None:
        if not MASSES[0] <= mass <= MASSES[1]:
            raise ExportError(f"the mass must be a positive number of kg ({MASSES[0]:g} to {MASSES[1]:g}), got {mass}")
        beam = replace(beam, mass_per_length=Uniform(mass / beam.length))
    return RodSample(beam, section, damping_time=damping_time, sites=sites, uncertain=uncertain)


_LEAST = 1e-3  # of a share: less is none


def in_setup(rod: RodSample, numbers: Array) -> RodSample:
    """The beam with the stretch, shear and relaxation that the `numbers` (n,) of its set-up say."""
    setup = rod.setup
    assert setup is not None
    part = {name: numbers[where] for name, where in setup.columns.items()}
    if "section" in part:
        share = max(1.0 + float(part["section"][0]), 0.0)
        if rod.section is not None and rod.section.shape in _GYRATION:
            rod = replace(rod, softer=max(share, _LEAST))
        else:
            thickness = setup.thickness * math.sqrt(share) if share > _LEAST else None
            rod = replace(rod, beam=replace(rod.beam, thickness=thickness))
    shares = np.maximum(part.get("relaxation", np.zeros(0)), 0.0)
    if not setup.times or not np.any(shares > _LEAST):
        return replace(rod, relaxation=(), instantaneous=1.0)
    shares = shares / max(1.0, float(shares.sum()) / MOST_REACHED)
    reached = min(float(shares @ setup.reached), MOST_REACHED)
    relaxation = tuple(Relaxing(float(a), tau) for a, tau in zip(shares, setup.times, strict=True))
    return replace(rod, relaxation=relaxation, instantaneous=1.0 / (1.0 - reached))


def drawn(rod: RodSample, count: int, *, seed: int) -> tuple[RodSample, ...]:
    """Beams as probable as the data say, k(s) jointly with stretch, shear, relaxation and damping; at every place and
    level the quantiles of many are the band's.

    The draws of log k are normal. Where the band has another `shape`, the values at a place are moved to the quantiles
    of that shape, in the same order.

    Raises `ExportError`: the beam has no band.
    """
    known, setup = rod.uncertain, rod.setup
    if known is None:
        raise ExportError(
            "this beam has no band to draw from; learn it with `onebend learn`, or export without samples"
        )
    if setup is None:
        profiles, numbers = known.draw(count, seed=seed), None
    else:
        coefficients, numbers = setup.draw(known, count, seed=seed)
        gain = known.gain_sd * np.random.default_rng([seed, 1]).standard_normal((count, 1))
        profiles = tuple(known.profile_of(one) for one in coefficients + gain)
    wide = np.exp(rod.damping_sd * np.random.default_rng([seed, 2]).standard_normal(count))
    known_time = rod.damping_time is not None
    times = np.clip(rod.loss_time * wide, *TIMES).tolist() if known_time else [None] * count
    beams = (
        replace(rod, beam=replace(rod.beam, stiffness=k), damping_time=time, damping_sd=0.0, uncertain=None)
        for k, time in zip(_shaped(profiles, known), times, strict=True)
    )
    if numbers is None:
        return tuple(beams)
    return tuple(in_setup(one, at) for one, at in zip(beams, numbers, strict=True))


DRAWS = 400  # for the bands of what is no k(s)
_ENDS = (0.025, 0.975)


def drawn_for_bands(rod: RodSample) -> tuple[RodSample, ...]:
    """The draws of the bands below; () where no band of k(s) is known."""
    return () if rod.uncertain is None else drawn(rod, DRAWS, seed=0)


def axial_bands(rod: RodSample, draws: tuple[RodSample, ...], s: Array) -> dict[str, Array]:
    """(2, S) N, the 95 % bands of "EA" and "kGA" at `s`; NaN where they, or the band of k(s), are not known."""
    if not draws or not rod.stretches:
        return dict.fromkeys(("EA", "kGA"), np.full((2, len(s)), np.nan))
    values = np.array([one.axial(s) for one in draws])  # infinite where a draw does not stretch
    low, high = np.quantile(values, _ENDS, axis=0, method="inverted_cdf")
    return {"EA": np.stack([low[0], high[0]]), "kGA": np.stack([low[1], high[1]])}


def relaxing_bands(rod: RodSample, draws: tuple[RodSample, ...]) -> tuple[tuple[float, float], ...]:
    """The 95 % band of the share that relaxes with each time; () where no band is known."""
    if not draws or rod.setup is None or not rod.relaxation:
        return ()
    shares = {part.time: np.zeros(len(draws)) for part in rod.relaxation}
    for i, one in enumerate(draws):
        for part in one.relaxation:
            shares[part.time][i] = part.share
    low, high = np.quantile(np.array(list(shares.values())), _ENDS, axis=1)
    return tuple(zip(low.tolist(), high.tolist(), strict=True))


def _shaped(profiles: tuple[LogSpline, ...], uncertain: UncertainStiffness) -> tuple[LogSpline, ...]:
    if uncertain.shape is None:
        return profiles
    known = uncertain.offset or Polyline((0.0, 1.0), (0.0, 0.0))
    more = np.setdiff1d(_GRID, known.s)
    s, values = np.concatenate([known.s, more]), np.concatenate([known.values, known(more)])
    order = np.argsort(s, kind="stable")  # a step's two places stay as they are
    s, values = s[order], values[order]
    sd = uncertain.log_at(s)[1]
    away = (np.array([one.coefficients for one in profiles]) - uncertain.mean) @ uncertain.basis(s).T
    z = away / np.maximum(np.hypot(sd, uncertain.gain_sd), np.finfo(float).tiny)
    level = 2.0 * ndtr(np.abs(z)) - 1.0
    shape = np.stack([np.interp(s, SHAPE_PLACES, widths) for widths in uncertain.shape], axis=1)
    widening = np.stack([np.interp(level[:, j], SHAPE_LEVELS, widths) for j, widths in enumerate(shape)], axis=1)
    offsets = values + z * np.hypot(widening * sd, uncertain.gain_sd) - away
    return tuple(
        replace(one, offset=Polyline(tuple(s.tolist()), tuple(offset.tolist()), known.jumps))
        for one, offset in zip(profiles, offsets, strict=True)
    )


# What a target leaves out, in words, with the amount.


def _stretch_words(rod: RodSample) -> str:
    """How far stretch and shear move the tip under the largest recorded force; of a section that is no rectangle
    nearly so."""
    if not rod.stretches:
        return ""
    firm, k = replace(rod.beam, thickness=None), rod.stiffness(_GRID)
    squared = float(np.mean(12.0 * k * firm.length / rod.axial(_GRID)[0]))
    soft = rod.beam if rod.beam.thickness else replace(firm, thickness=math.sqrt(squared), varies="width")
    force, at_s = rod.push or ((0.0, float(np.mean(k)) / firm.length), 1.0)
    try:
        moved = soft.equilibrium(force, at_s).xy(1.0) - firm.equilibrium(force, at_s).xy(1.0)
    except MechanicsError:
        return "by an unknown amount, for the beam snaps through under its largest force"
    words = _mm(float(np.linalg.norm(moved)), firm.length)
    return f"under {math.hypot(*force):.3g} N at s = {at_s:g} they move the tip by {words}"


def _rest_words(rod: RodSample) -> str:
    curved = rod.beam.equilibrium((0.0, 0.0)).xy(1.0)
    straight = rod.beam.length * np.array([math.cos(rod.beam.clamp_angle), math.sin(rod.beam.clamp_angle)])
    moved = float(np.linalg.norm(curved - straight))
    return f"at rest the tip is {_mm(moved, rod.beam.length)} off" if moved > 1e-6 * rod.beam.length else ""


def _relaxation_words(rod: RodSample) -> str:
    if not rod.relaxation:
        return ""
    first, last = 100.0 * (rod.instantaneous - 1.0), 100.0 * (1.0 - rod.relaxed)
    return f"the beam is {first:.1f} % stiffer at first, and {last:.1f} % softer after a long hold"


def _riding_words(rod: RodSample) -> str:
    masses = rod.beam.masses
    return f"{len(masses)}, together {1e3 * sum(one.mass for one in masses):.3g} g" if masses else ""


def damping_words(rod: RodSample) -> str:
    """Damping over stiffness, with its band where there is one."""
    if rod.damping_time is None:
        return ""
    band = "; 95 %: {:.3g} to {:.3g} s".format(*rod.damping_band) if rod.damping_sd > 0.0 else ""
    return f"over stiffness: {rod.damping_time:.3g} s{band}"


def _mm(metres: float, length: float) -> str:
    return f"{1e3 * metres:.2g} mm ({100.0 * metres / length:.2g} % of the length)"


PARTS: Mapping[str, Callable[[RodSample], str]] = {  # of a beam, beside k(s) and the mass
    "rest shape": _rest_words,
    "riding masses": _riding_words,
    "stretch and shear": _stretch_words,
    "relaxation": _relaxation_words,
    "damping": damping_words,
}


def left_out(rod: RodSample, carries: frozenset[str]) -> tuple[str, ...]:
    """What this beam has beside the parts that a target `carries`: sentences with the amount."""
    found = ((part, words(rod)) for part, words in PARTS.items() if part not in carries)
    return tuple(f"Left out: {part} ({amount})." for part, amount in found if amount)
