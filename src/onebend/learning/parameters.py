"""The parameters of a fit in one vector: k(s), what all recordings of the beam share, and what each has of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import null_space

from onebend import records
from onebend.beam.section import moment_errors, relative_moment
from onebend.beam.stiffness import LogSpline, Polyline, Profile, Uniform
from onebend.errors import LearningError
from onebend.learning.allowances import ANYTHING, BETWEEN, EFFECTS, TOLERATED, Allowance
from onebend.learning.frames import zeroed_coordinates
from onebend.recording.beam_frame import MOUNTING_SD
from onebend.records import Array

# Stated shape of k: log k(s) = o(s) + l + e(s) + v(s). o is log I(s) of the section less its mean (zero for an "even"
# k), l one level, e the effect of errors of the section's sizes, v a slow variation of the modulus: a Gaussian process
# of the stated sd with correlation exp(-d^2 / (2 C^2)) at a distance d.

CORRELATION = 0.5  # C, of the length
_LEAST = 1e-8  # of the largest: smaller parts of the slow variation are left out
_PLACES = np.linspace(0.0, 1.0, 201)


@dataclass(frozen=True)
class KnownShape:
    """How k varies along the beam but for a factor, as stated."""

    section: records.StatedSection | None  # whose second moment k goes with; None: k is one number
    varies: float  # one sd of the slow variation of log k

    @cached_property
    def offset(self) -> Polyline | None:
        """o(s); None where it is zero."""
        return None if self.section is None else relative_moment(self.section)

    @property
    def profile(self) -> Profile:
        """exp o(s): k over its geometric mean."""
        if self.offset is None:
            return Uniform(1.0)
        return LogSpline((0.0, 0.0, 1.0, 1.0), (0.0, 0.0), 1, self.offset)

    def offset_at(self, s: Array) -> Array:
        """`s.shape`: o."""
        return np.zeros(np.shape(s)) if self.offset is None else self.offset(s)

    def errors(self, s: Array) -> Array:
        """(S, n) functions whose coefficients, of sd one each, make e(s)."""
        return np.zeros((len(s), 0)) if self.section is None else moment_errors(self.section, s)

    def slow(self, s: Array) -> Array:
        """(S, n) functions whose coefficients, of sd one each, make v(s) (Karhunen and Loeve)."""
        apart = _PLACES[:, None] - _PLACES
        values, vectors = np.linalg.eigh(np.exp(-0.5 * (apart / CORRELATION) ** 2))
        kept = values > _LEAST * values[-1]
        functions = self.varies * vectors[:, kept] * np.sqrt(values[kept])
        columns = [np.interp(s, _PLACES, function) for function in functions.T if self.varies > 0.0]
        return np.stack(columns, axis=1) if columns else np.zeros((len(s), 0))


def with_shared_shape(recordings: Sequence[records.Observations]) -> Sequence[records.Observations]:
    """The recordings of a beam, each with what one of them states of its shape.

    Raises:
        LearningError: as `known_shape`.
    """
    known = known_shape(recordings)
    if known is None:
        return recordings
    along: records.StiffnessAlong = "even" if known.section is None else "section"
    out = [replace(o.stated, stiffness_along=along, modulus_varies=known.varies) for o in recordings]
    if known.section is not None:
        out = [replace(stated, section=known.section) for stated in out]
    return [replace(o, stated=stated) for o, stated in zip(recordings, out, strict=True)]


def known_shape(recordings: Sequence[records.Observations]) -> KnownShape | None:
    """The stated shape of k, from any recording of the beam; None where nothing is stated.

    Raises:
        LearningError: the recordings contradict each other.
    """
    said = [o.stated for o in recordings if o.stated.stiffness_along != "unknown"]
    names = ", ".join(o.source.name for o in recordings)
    if len({one.stiffness_along for one in said}) > 1 or len({one.modulus_varies for one in said}) > 1:
        raise LearningError(
            f"{names}: stiffness_along or modulus_varies differ. It is one beam: write the same in each recording"
        )
    if not said:
        return None
    section = next((one.section for one in said if one.section is not None), None)
    if said[0].stiffness_along == "section" and section is None:
        raise LearningError(f'{names}: stiffness_along = "section" needs the section in one of them')
    return KnownShape(section if said[0].stiffness_along == "section" else None, said[0].modulus_varies)


# log k(s) as a cubic B-spline. Its prior is a sum of level and slope, a smooth part whose second derivative is white
# noise of size `tau`, steps between coefficients, and bumps of three or four coefficients. Steps of one size `rho` are
# a random walk, without bumps; steps of individual sizes: see `normal.py`. Where the film shows the body's width w, a
# part goes with log w: of one material, k goes with the cube of w if the body is as deep everywhere, with its fourth
# power if it is round. The power is unknown, for a body may have several materials, or a sleeve.

LEVEL_SD = 4.0  # of log k: a factor of 55 either way around the start
SLOPE_SD = 3.0  # of log k from clamp to tip: a factor of 20 either way
TAU, RHO = 8.0, 0.3  # roughness and steps of log k that are expected, where all steps are taken to be alike
SPREAD = 1.2  # one sd of their logs: a factor of ten either way
POWER = 3.0  # of the width: one sd
# Of the width that an outline shows, over itself: one sd of a white error at every place, and of one that is alike over
# `_ALIKE`; and its roughness. The likeliest of each is taken.
_WIDTH_SD, _ROUGH = (0.002, 0.004, 0.008, 0.016, 0.032), (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
_ALIKE = 0.07  # of the length
_SHOWN = 1e-3  # of the variance: what is left out of the errors of the width
_DEGREE = 3
_BUMP = 1.5 / 8.0 * np.array([1.0, 4.0, 6.0, 4.0, 1.0])  # a cubic B-spline on intervals twice as long, of height one
_WITHIN = 20  # places of a step between two coefficients that are averaged over


@dataclass(frozen=True, eq=False)
class Spline:
    """`count` B-splines on equal intervals of [0, 1]. Splines are equal only to themselves."""

    count: int
    besides: Array | None = None  # (count, n) coefficients of further parts, of sd one each

    @cached_property
    def knots(self) -> Array:
        """With the ends repeated."""
        inner = np.linspace(0.0, 1.0, self.count - _DEGREE + 1)
        return np.concatenate([np.zeros(_DEGREE), inner, np.ones(_DEGREE)])

    def basis(self, s: Array) -> Array:
        """`s.shape + (count,)`."""
        flat = np.clip(np.ravel(s), 0.0, 1.0)
        return np.asarray(BSpline.design_matrix(flat, self.knots, _DEGREE).toarray().reshape(*np.shape(s), self.count))

    def nearest(self, function: Callable[[Array], Array]) -> Array:
        """(count, ...) coefficients of the least squares nearest to a function of places s (S,), (S, ...)."""
        s = np.linspace(0.0, 1.0, 8 * self.count)
        return np.asarray(np.linalg.lstsq(self.basis(s), function(s), rcond=None)[0])

    def variances(self, tau: float | Array, rho: float | Array) -> Array:
        """`tau.shape + (n,)` of the parts: level, slope, the smooth part's `count - 2`, `count - 1` steps, no bumps."""
        out = np.ones((*np.shape(tau), self.parts.shape[1]))
        out[..., self.local] = 0.0
        out[..., 0], out[..., 1] = LEVEL_SD**2, SLOPE_SD**2
        out[..., 2 : self.count] = np.square(tau)[..., None]
        out[..., self.count : 2 * self.count - 1] = np.square(rho)[..., None] * self.gaps
        return out

    @property
    def local(self) -> slice:
        """Which of the parts are steps and bumps."""
        return slice(self.count, 3 * self.count - 1)

    @cached_property
    def gaps(self) -> Array:
        """(count - 1,) distances of the places of the coefficients."""
        return np.diff(self._places)

    @cached_property
    def parts(self) -> Array:
        """(count, n) coefficients of the independent parts that log k is the sum of."""
        s = np.linspace(0.0, 1.0, 101)
        basis = self.basis(s)
        level, slope = basis.mean(axis=0), ((s - 0.5) @ basis) / np.sum((s - 0.5) ** 2)
        both = np.stack([level, slope])
        line = np.stack([np.ones(self.count), self._places - 0.5], axis=1)
        bent = null_space(both)
        values, vectors = np.linalg.eigh(bent.T @ self._bending @ bent)
        steps = np.tril(np.ones((self.count, self.count)), -1)[:, :-1]
        wide = len(_BUMP) // 2
        bumps = sum(height * np.eye(self.count, k=i - wide) for i, height in enumerate(_BUMP))
        local = np.concatenate([steps, bumps, *(() if self.besides is None else (self.besides,))], axis=1)
        return np.concatenate(
            [line @ np.linalg.inv(both @ line), bent @ vectors / np.sqrt(values), local - level @ local], axis=1
        )

    @cached_property
    def share(self) -> Array:
        """(2 count - 1,) of the beam that each step and each bump stands for."""
        return np.concatenate([self.gaps, np.full(self.count, 1.0 / self.count)])

    @cached_property
    def finer(self) -> Spline:
        """The splines on intervals half as long."""
        return Spline(2 * (self.count - _DEGREE) + _DEGREE)

    @cached_property
    def on_finer(self) -> Array:
        """(count of the finer, count): the same functions by the finer ones' coefficients."""
        return self.finer.nearest(self.basis)

    @cached_property
    def unseen(self) -> Array:
        """(count - 1, f, f) covariance of the spline's error for a step between two coefficients, in finer splines."""
        at = self.finer._places
        whole = self.basis(at)
        out = []
        for i in range(self.count - 1):
            where = np.linspace(self._places[i], self._places[i + 1], 2 * _WITHIN + 1)[1::2]
            away = (at > where[:, None]) - whole[:, i + 1 :].sum(axis=1)
            out.append(away.T @ away / _WITHIN)
        return np.stack(out)

    @cached_property
    def _places(self) -> Array:
        """(count,) where the coefficients act (Greville)."""
        return np.array([np.mean(self.knots[i + 1 : i + 1 + _DEGREE]) for i in range(self.count)])

    @cached_property
    def _bending(self) -> Array:
        """(count, count) `int b_i'' b_j'' ds`: exact with four Gauss points a piece."""
        x, w = np.polynomial.legendre.leggauss(4)
        edges = np.linspace(0.0, 1.0, self.count - _DEGREE + 1)
        h = edges[1] - edges[0]
        nodes = (edges[:-1, None] + 0.5 * h * (x + 1.0)).ravel()
        each = np.stack([BSpline(self.knots, e, _DEGREE).derivative(2)(nodes) for e in np.eye(self.count)], axis=1)
        return np.asarray(each.T @ (np.tile(0.5 * h * w, len(edges) - 1)[:, None] * each))


def with_width(spline: Spline, seen: Array) -> Spline:
    """The spline with the parts that go with the body's width, `seen` as `Observations.width`: `POWER` times its log,
    and its errors. The log is smooth as that of k, by as much as it shows; where it is hidden, it is interpolated so
    (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2.2 and 5.4)."""
    s, log_width = seen[:, 0], np.log(seen[:, 1])
    parts = spline.parts[:, : spline.count]
    there, alike = spline.basis(s) @ parts, np.eye(len(s)) + np.exp(-np.abs(s[:, None] - s) / _ALIKE)

    def known(tau: float, noise: float) -> tuple[float, Array, Array]:
        """Log evidence of these sizes, and mean (p,) and covariance (p, p) of the coefficients."""
        before = spline.variances(tau, 0.0)[: spline.count]
        root = np.linalg.cholesky((there * before) @ there.T + noise**2 * alike)
        white = np.linalg.solve(root, np.column_stack([log_width, there * before @ parts.T]))
        log_evidence = -0.5 * float(white[:, 0] @ white[:, 0]) - float(np.sum(np.log(np.diag(root))))
        covariance = (parts * before) @ parts.T - white[:, 1:].T @ white[:, 1:]
        return log_evidence, white[:, 1:].T @ white[:, 0], covariance

    _, mean, covariance = max((known(*sizes) for sizes in product(_ROUGH, _WIDTH_SD)), key=lambda one: one[0])
    values, vectors = np.linalg.eigh(covariance)
    kept = np.cumsum(np.maximum(values, 0.0)) > _SHOWN * np.sum(values)
    errors = vectors[:, kept] * np.sqrt(values[kept])
    return replace(spline, besides=POWER * np.column_stack([mean, errors]))


# The beam's mass: weight alone tells only mu / k; a force of known size tells both.

FREE = 2.0  # one sd of an unknown mass, over its first guess: next to no knowledge
LEARNED = 0.7  # of the prior's sd: a weighed mass with a larger posterior sd was not learned
KNOWN = 0.35  # of itself: an unknown mass with a larger posterior sd was not learned
NEEDS_MASS = "gravity acts in the plane (or it swings), so the beam's mass must be given: mass_kg in [beam]"


@dataclass(frozen=True)
class LearnedMass:
    """The beam's mass after the fit."""

    value: float  # kg
    sd: float  # kg
    even: float  # kg, of an evenly heavy beam whose weight has the same moment about the clamp: what the data see
    even_sd: float  # kg
    written: float  # kg, as recording.toml says; NaN where it does not
    identified: bool  # the data said more of it than was known
    along: records.MassAlong = "unknown"  # how it is spread, as stated


def weighs(observations: records.Observations) -> bool:
    """Whether the beam's own weight bends it in the plane."""
    return bool(np.any(observations.gravity != 0.0))


def needs_mass(observations: records.Observations) -> bool:
    """Whether its mass counts: it weighs, or was seen to swing."""
    return weighs(observations) or bool(observations.frequencies)


def _alike(recordings: Sequence[records.Observations]) -> Sequence[records.Observations]:
    """The recordings, each with the spread of the mass that one of them states."""
    said = sorted({o.stated.mass_along for o in recordings} - {"unknown"})
    if len(said) > 1:
        names = ", ".join(o.source.name for o in recordings)
        raise LearningError(f"{names}: mass_along is {' and '.join(said)}. It is one beam: write the same in each")
    return [replace(o, stated=replace(o.stated, mass_along=said[0])) for o in recordings] if said else recordings


def mass_is_open(recordings: Sequence[records.Observations]) -> bool:
    """Whether the mass counts and no recording of the beam says it."""
    return any(needs_mass(o) for o in recordings) and not any(np.isfinite(o.stated.mass) for o in recordings)


def check_mass_can_be_learned(recordings: Sequence[records.Observations]) -> None:
    """Raises `LearningError` where the data hold only the ratio of stiffness to mass."""
    carries = any(one.tip_mass > 0.0 for o in recordings for one in o.frequencies)
    if carries or not mass_is_open(recordings) or any(forced(o) for o in recordings):
        return
    names = ", ".join(o.source.name for o in recordings)
    if not any(weighs(o) for o in recordings):
        raise LearningError(
            f"{names}: there is nothing but frequencies, and the mass is not written down. They hold only the ratio "
            "k/mu of stiffness to mass per metre. Give mass_kg in [beam], or measure them once more with a known "
            "tip_mass_kg, or add poses under a known weight"
        )
    raise LearningError(
        f"{names}: the beam's own weight is all that bends it, and its mass is not written down. Such data hold only "
        "the ratio k/mu of stiffness to mass per metre. Give mass_kg in [beam], or learn together with a push or a "
        "hung weight of known size"
    )


def forced(observations: records.Observations) -> bool:
    """Whether something other than the beam's own weight acts on it."""
    hung = observations.known_loads is not None or (weighs(observations) and bool(observations.stated.masses))
    return bool(np.nanmax(np.abs(observations.force), initial=0.0) > 0.0) or hung


def shared_mass(recordings: Sequence[records.Observations], guess: float = np.nan) -> tuple[records.Observations, ...]:
    """The recordings, those without a mass with that of the others; where none says it, with a `guess` [kg]."""
    recordings = _alike(recordings)
    known = [o.stated for o in recordings if np.isfinite(o.stated.mass)]
    if known:
        mass, line = known[0].mass, known[0].mass_line
        given = (replace(o.stated, mass=mass, mass_line=line) for o in recordings)
        pairs = zip(recordings, given, strict=True)
        return tuple(o if np.isfinite(o.stated.mass) else replace(o, stated=stated) for o, stated in pairs)
    if not mass_is_open(recordings) or not np.isfinite(guess):
        return tuple(recordings)
    return tuple(replace(o, stated=replace(o.stated, mass=guess, mass_sd=FREE)) for o in recordings)


END_SD = (0.2, 2.0)  # of the length, rad: of a held end before the data, around where its points put it
_BEYOND_SD = 0.005  # of the length: its error, by which a push at the tip may seem to act beyond it
_EVEN = 0.01  # of k: what is left of its variation, from coefficient to coefficient, where its shape is stated
_EXACT = 1e-6  # of the mass, where it is said to be exact
_STATED = 1e-4  # of the mass: sd of its uneven parts where its spread is stated
_BY_HAND = (0.5, 1.0, 2.0)  # `sizes` of the tags' places over what is stated
_PLACEMENT_SD = 5e-4  # m, of the tags' places and the clamp's, where nobody states it
_MASS_SD = 0.02  # of the beam's mass as weighed; where gravity acts in the plane
MASS_SPREAD, _MASS_LINE = 0.3, 0.05  # of the same: Legendre parts of an uneven mass per metre, and where it is written
_CLOCK_DOUBT = 2.0  # the clock search's sd: over simulated recordings its errors are about twice as large


@dataclass(frozen=True)
class Block(Allowance):
    """An allowance among the parameters."""

    recording: int = -1  # -1: shared
    start: int = -1  # -1: frozen

    @property
    def where(self) -> slice:
        return slice(self.start, self.start + len(self.prior_sd))


@dataclass(frozen=True)
class Layout:
    """Where each block stands. The spline's coefficients come first; their prior is not diagonal."""

    spline: Spline
    blocks: tuple[Block, ...]
    size: int
    index: dict[tuple[str, int], Block] = field(default_factory=dict)
    known: KnownShape | None = None  # stated shape of k

    @cached_property
    def stiffness_parts(self) -> Array:
        """(p, n) coefficients of the independent parts of log k, less its stated shape, in the prior: a level, a small
        free part, errors of the section, the slow variation; `Spline.parts` without a stated shape."""
        if self.known is None:
            return self.spline.parts
        of_places = [self.spline.nearest(each) for each in (self.known.errors, self.known.slow)]
        return np.column_stack([np.ones(self.spline.count), np.eye(self.spline.count), *of_places])

    @property
    def first_variances(self) -> Array:
        """(n,) of these parts: as expected, or as stated."""
        if self.known is None:
            return self.spline.variances(TAU, RHO)
        out = np.ones(self.stiffness_parts.shape[1])
        out[0], out[1 : 1 + self.spline.count] = LEVEL_SD**2, _EVEN**2
        return out

    @cached_property
    def section_errors(self) -> Array:
        """(p, p) prior covariance of what the errors of the stated section are among the coefficients."""
        parts = np.zeros((self.spline.count, 0)) if self.known is None else self.spline.nearest(self.known.errors)
        return np.asarray(parts @ parts.T)

    def stiffness_root(self, variances: Array) -> Array:
        """(p, p) lower triangular factor of the coefficients' prior covariance, from the parts' variances (n,)."""
        return np.asarray(np.linalg.qr(np.sqrt(variances)[:, None] * self.stiffness_parts.T, mode="r")).T

    def get(self, x: Array, name: str, recording: int = -1) -> Array:
        """Values of a block of a recording, or of all; zeros (of the right length) where it is frozen."""
        block = self.index.get((name, recording)) or self.index[name, -1]
        return x[block.where] if block.start >= 0 else np.zeros(len(block.labels))

    def columns(self, name: str, recording: int) -> slice | None:
        """Columns of a block among the parameters of its recording (`known_to`); None where frozen."""
        return self.free_columns(recording).get(name)

    def free_columns(self, recording: int) -> dict[str, slice]:
        """Columns of all blocks that one recording depends on and that are not frozen, by the blocks' names."""
        return self._free_columns[recording]

    @cached_property
    def _free_columns(self) -> tuple[dict[str, slice], ...]:
        """Of each recording."""
        shared, *own = ({b.name: b.where for b in blocks} for blocks in self.free_blocks)
        away = [part.start - self.shared for part in self.parts[1:]]
        pairs = zip(own, away, strict=True)
        return tuple(shared | {n: slice(at.start - d, at.stop - d) for n, at in one.items()} for one, d in pairs)

    @property
    def shared(self) -> int:
        """Count of the parameters that all recordings share; they come first."""
        return int(self.parts[0].stop)

    @cached_property
    def free_blocks(self) -> tuple[tuple[Block, ...], ...]:
        """Blocks that are not frozen: those of the shared parameters, and then those of each recording."""
        count = 2 + max((b.recording for b in self.blocks), default=-1)
        out: list[list[Block]] = [[] for _ in range(count)]
        for block in self.blocks:
            out[1 + block.recording] += [block] if block.start >= 0 else []
        return tuple(tuple(blocks) for blocks in out)

    @cached_property
    def parts(self) -> tuple[slice, ...]:
        """Where the shared parameters stand, and then the own ones of each recording."""
        counts = [sum(len(b.prior_sd) for b in blocks) for blocks in self.free_blocks]
        ends = np.cumsum(counts).tolist()
        return tuple(slice(end - count, end) for count, end in zip(counts, ends, strict=True))

    def known_to(self, recording: int) -> records.IntArray:
        """Indices of the parameters that one recording depends on: the shared ones and its own."""
        own = self.parts[1 + recording]
        return np.concatenate([np.arange(self.shared), np.arange(own.start, own.stop)])


@dataclass(frozen=True)
class StatedError:
    """An error of every bench, to within a tolerance: an entry of the list that the fit, the live learner, the planner
    and the reports read, as they read `allowances.EFFECTS`."""

    name: str
    cause: str  # its name in the reports; several may share one
    unit: str
    labels: tuple[str, ...]  # "{tag}" stands for each tag
    # The field of `Stated` that states it, or the sds of recordings: of all where they share it, else of one.
    stated: str | Callable[[Sequence[records.Observations]], float | Array]
    usual: float = 0.0  # where nobody states it; 0: frozen
    shared: bool = False
    of_push: bool = False  # nothing without a push

    @property
    def of_tags(self) -> bool:
        """Each tag has its own."""
        return "{tag}" in self.labels[0]

    @property
    def field(self) -> str:
        """Of `Instruments`, its sd."""
        return "placement_sd" if self.name in ("along", "across") else f"{self.name}_sd"

    def allowance(self, recordings: Sequence[records.Observations], tags: Sequence[str]) -> Allowance:
        """As these recordings state it, of these tags."""
        one, within = recordings[0], ANYTHING
        if self.name == "place":  # hardly beyond the tip
            within = -np.inf, _BEYOND_SD * one.length + float(np.nanmin(1.0 - one.push_s)) * one.length
        of_stated = self.stated
        if self.of_push and (one.static or not np.any(one.force != 0.0)):
            sd: float | Array = 0.0
        else:
            sd = getattr(one.stated, of_stated) if isinstance(of_stated, str) else of_stated(recordings)
        return replace(self.with_sd(sd, tags), within=within)

    def with_sd(self, sd: float | Array, tags: Sequence[str]) -> Allowance:
        """With this prior."""
        places = tags if self.of_tags else ("",)
        labels = tuple(label.format(tag=tag) for tag in places for label in self.labels)
        sds = np.full(len(labels), sd, dtype=float)
        own = Allowance(self.name, "bench", self.unit, labels, sds, shared=self.shared)
        if self.cause in (_TAGS, _CLAMP):  # made anew on every bench
            return replace(own, sizes=_BY_HAND, together=True) if self.field == "placement_sd" and self.of_tags else own
        return replace(own, sizes=TOLERATED, together=True)


def clamp_sd(one: records.Observations) -> float:
    """rad, prior sd of the clamp's direction in the recording's frame; 0 freezes it.

    The frame's x axis is the line through the tags at rest, so twice the spread of their places is added. Where the
    beam is curved at rest, or rest was not seen, the mounting of a base tag is added instead. Poses have the stated sd.
    """
    stated = one.stated.clamp_sd
    if stated == 0.0 or (one.static and np.isfinite(stated)):
        return stated
    own = stated if np.isfinite(stated) else records.CLAMP_SD
    reach = one.length * one.marker_s[np.isfinite(one.rest_xy).all(axis=1)]
    if curvature_sd(one) > 0.0 or not np.any(reach > 0.0):
        return float(np.hypot(own, MOUNTING_SD))
    return float(np.hypot(own, 2.0 * one.stated.placement_sd / np.linalg.norm(reach)))


def curvature_sd(one: records.Observations) -> float:
    """rad, of the Legendre states of q0 before the data; 0 where the beam is straight at rest."""
    return 0.0 if one.stated.rest == "straight" else one.stated.curvature_sd


def scale_sd(one: records.Observations) -> float:
    """Of lengths in the picture before the data; a calibration gives them exactly, unless the recording says other."""
    if one.source.view is None:
        return 0.0
    usual = 0.0 if one.source.view.calibrated else records.SCALE_SD
    return one.stated.scale_sd if np.isfinite(one.stated.scale_sd) else usual


def _clock_sd(one: records.Observations) -> float:
    if one.source.clock is None:
        return 0.0
    return _CLOCK_DOUBT * float(one.source.clock.sd) if np.isfinite(one.source.clock.sd) else 1.0


def _mass_sds(recordings: Sequence[records.Observations]) -> float | Array:
    """Of a mass that is guessed or written down, over itself, and of its parts, which are free where it is exact."""
    if not any(needs_mass(r) for r in recordings):
        return 0.0
    guessed, weighed = (
        [sd for sd in sds if np.isfinite(sd)]
        for sds in zip(*((r.stated.mass_sd, r.stated.weighed_sd) for r in recordings), strict=True)
    )
    mass = max(guessed, default=max(min(weighed), _EXACT) if weighed else _MASS_SD)
    spread = _MASS_LINE if any(r.stated.mass_line is not None for r in recordings) else MASS_SPREAD
    if any(r.stated.mass_along != "unknown" for r in recordings):
        spread = _STATED
    return np.array([mass, spread, spread, spread])


_REST = ("q0 mean", "q0 slope", "q0 bow")
_MASS = ("mass", "mass slope", "mass bow", "mass third")
_DIRECTION, _AXES = "direction of the force", ("force axes",)


def _of_one(sd: Callable[[records.Observations], float]) -> Callable[[Sequence[records.Observations]], float]:
    """The largest; of one recording its own."""
    return lambda recordings: max(sd(one) for one in recordings)


_TAGS, _CLAMP, _PLACED = "places of the tags", "clamp and origin", "placement_sd"
STATED_ERRORS = (
    StatedError("curvature", "rest shape", "rad", _REST, _of_one(curvature_sd), records.CURVATURE_SD, shared=True),
    StatedError("mass", "mass", "1", _MASS, _mass_sds, _MASS_SD, shared=True),
    StatedError("along", _TAGS, "m", ("{tag} along",), _PLACED, _PLACEMENT_SD, shared=True),
    StatedError("across", _TAGS, "m", ("{tag} across",), _PLACED, _PLACEMENT_SD, shared=True),
    StatedError("turn", _TAGS, "rad", ("{tag} turn",), "turn_sd", records.TURN_SD, shared=True),
    StatedError("clamp", _CLAMP, "rad", ("clamp angle",), _of_one(clamp_sd), records.CLAMP_SD),
    StatedError("origin", _CLAMP, "m", ("origin x", "origin y"), _PLACED, _PLACEMENT_SD),
    StatedError("scale", "camera", "1", ("camera scale",), _of_one(scale_sd)),
    StatedError("clock", "clock", "s", ("clock offset",), _of_one(_clock_sd)),
    StatedError("place", "place of the push", "m", ("push place",), "place_sd", records.PLACE_SD, of_push=True),
    StatedError("direction", _DIRECTION, "rad", _AXES, "direction_sd", records.DIRECTION_SD, of_push=True),
)


def groups() -> dict[str, tuple[str, ...]]:
    """Names of all allowances of real benches, by the common name of their cause."""
    every = [(effect.cause, name) for name, effect in EFFECTS.items()]
    every += [(error.cause, error.name) for error in STATED_ERRORS]
    every += [("rest shape", "rest change"), ("mountings", BETWEEN), ("error of the force log", "force")]
    return {cause: tuple(name for of, name in every if of == cause) for cause, _ in every}


def make_layout(
    spline: Spline,
    recordings: list[records.Observations],
    knots: list[int],
    allowances: Sequence[Sequence[Allowance]] = (),
) -> Layout:
    """The layout for several recordings, with the `knots` of the force error and the `allowances` of each."""
    tags = [f"tag {i}" for i in recordings[0].tag_id[records.tags_among(recordings[0])]]
    shared = {a.name: a for own in allowances for a in own if a.shared}
    wanted = [(-1, error.allowance(recordings, tags)) for error in STATED_ERRORS if error.shared]
    wanted += [(-1, a) for a in shared.values()]
    for r, one in enumerate(recordings):
        own = [error.allowance([one], tags) for error in STATED_ERRORS if not error.shared]
        own += [a for a in (allowances[r] if allowances else ()) if not a.shared]
        own += [
            inside("rest change", "rad", rest_change_sd(recordings, r), _REST),
            inside("zero", "m", one.length, _zeros(one)),
            inside("end", "m", END_SD[0] * one.length, _ends(one, "x", "y")),
            inside("end turn", "rad", END_SD[1], _ends(one, "angle")),
            inside("force", "N", 1.0, tuple(f"force error {a}{i}" for i in range(knots[r]) for a in "xy")),
        ]
        named = [tuple(f"{one.source.name}: {label}" for label in a.labels) for a in own]
        wanted += [(r, replace(a, labels=labels)) for a, labels in zip(own, named, strict=True)]
    return layout_of(spline, wanted, known_shape(recordings))


def layout_of(spline: Spline, wanted: Sequence[tuple[int, Allowance]], known: KnownShape | None = None) -> Layout:
    """The layout of log k and of these allowances, each with the number of its recording; without a prior sd they are
    frozen."""
    first = inside("stiffness", "log(N m)", 1.0, tuple(f"c{i}" for i in range(spline.count)))
    blocks, start = [], 0
    for recording, one in ((-1, first), *wanted):
        free = len(one.labels) > 0 and float(one.prior_sd[0]) > 0.0
        blocks.append(Block(**vars(one), recording=recording, start=start if free else -1))
        start += len(one.labels) if free else 0
    return Layout(spline, tuple(blocks), start, {(b.name, b.recording): b for b in blocks}, known)


def without_recording() -> list[Allowance]:
    """Groups that recordings have and frames as they come have not."""
    return [inside("rest change", "rad", 0.0, _REST), inside("zero", "m", 0.0, ()), inside("force", "N", 0.0, ())]


def inside(name: str, unit: str, sd: float, labels: tuple[str, ...]) -> Allowance:
    """A group of the model's own."""
    return Allowance(name, "bench", unit, labels, np.full(len(labels), sd))


def rest_change_sd(recordings: Sequence[records.Observations], r: int) -> float:
    """rad, of the Legendre states of q0 of one recording; 0 for one recording alone, or an unchanged rest."""
    return recordings[r].stated.rest_change_sd if len(recordings) > 1 else 0.0


def _ends(one: records.Observations, *what: str) -> tuple[str, ...]:
    """Labels of the ends that an unknown wrench holds, pose by pose."""
    held = np.zeros(0, dtype=int) if one.held is None else np.flatnonzero(one.held)
    return tuple(f"held end {i + 1} {name}" for i in held.tolist() for name in what)


def _zeros(one: records.Observations) -> tuple[str, ...]:
    """Labels of the readings that count from a zero of their own."""
    return tuple(f"zero of point {one.tag_id[i]} {'xy'[c]}" for i, c in zeroed_coordinates(one))


def log_axes(direction: Array) -> Array:
    """(2, 2) rotation of the logged force, by its direction (1,) [rad]."""
    cos, sin = np.cos(direction[0]), np.sin(direction[0])
    return np.array([[cos, -sin], [sin, cos]])
