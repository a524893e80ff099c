"""The parameters of a fit in one vector: k(s), what all recordings of the beam share, and what each has of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.learning.known_shape import KnownShape, known_shape
from onebend.learning.model.mass import needs_mass
from onebend.learning.model.readings import zeroed_coordinates
from onebend.learning.model.spline import LEVEL_SD, RHO, TAU, Spline
from onebend.recording.beam_frame import MOUNTING_SD
from onebend.records import CLAMP_SD, SCALE_SD, Array, IntArray, Observations

END_SD = (0.2, 2.0)  # of the length, rad: of a held end before the data, around where its points put it
_REST = ("mean", "slope", "bow")  # of the curvature at rest
_EVEN = 0.01  # of k: what is left of its variation, from coefficient to coefficient, where its shape is stated
_EXACT = 1e-6  # of the mass, where it is said to be exact
_STATED = 1e-4  # of the mass: what is left of its parts where somebody knows how it is spread
_CLOCK_DOUBT = 2.0  # the clock search's sd: over simulated recordings its errors are about twice as large


@dataclass(frozen=True)
class Priors:
    """One sd of each nuisance before the data; 0 freezes it."""

    curvature: float | None = None  # rad, Legendre states of q0; frozen where rest = "straight"; None: as turns
    mounting: float | None = None  # rad, a tag's turn on the beam; None: as the recording says
    placement: float | None = None  # m, a tag's place along and across; None: as the recording says
    clamp: float | None = None  # rad, the clamp's direction against the beam's own at rest; see `clamp_sd`
    origin: float | None = None  # m, the clamp's place against the base tag; None: as the recording says
    scale: float | None = None  # of lengths in the picture, where the camera is not calibrated; see `scale_sd`
    mass: float = 0.02  # of the beam's mass as weighed; where gravity acts in the plane
    mass_spread: float = 0.3  # of the same: Legendre parts of an uneven mass per metre
    mass_line: float = 0.05  # of the same, where the mass per metre is written down along the beam
    clock: float | None = None  # s; None: as the clock's own estimate says
    place: float | None = None  # m, along the beam, from where the push is said to act; None: as the recording says
    direction: float | None = None  # rad, of the force log's axes; None: as the recording says


@dataclass(frozen=True)
class Block:
    """Some parameters that belong together."""

    name: str
    recording: int  # -1: shared
    unit: str
    prior_sd: Array
    labels: tuple[str, ...]
    start: int

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
    known: KnownShape | None = None  # how k varies, where somebody states it

    @cached_property
    def stiffness_parts(self) -> Array:
        """(p, n) coefficients of the independent parts that log k, less what is known of it, is the sum of before the
        data: a level, what is left of an even k, the section's errors, the slow variation. `Spline.parts` where nothing
        is stated."""
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
        """(p, p) lower triangular factor of the coefficients' prior covariance, from the variances (n,) of the
        parts."""
        return np.asarray(np.linalg.qr(np.sqrt(variances)[:, None] * self.stiffness_parts.T, mode="r")).T

    def get(self, x: Array, name: str, recording: int = -1) -> Array:
        """Values of a block; zeros (of the right length) where it is frozen."""
        block = self.index[name, recording]
        return x[block.where] if block.start >= 0 else np.zeros(len(block.labels))

    def columns(self, name: str, recording: int = -1) -> slice | None:
        """Where a block's derivatives go among those that its recording knows (`known_to`); None where frozen."""
        block = self.index[name, recording]
        if block.start < 0:
            return None
        shift = 0 if recording < 0 else self.parts[1 + recording].start - self.shared
        return slice(block.where.start - shift, block.where.stop - shift)

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

    def known_to(self, recording: int) -> IntArray:
        """Indices of the parameters that one recording depends on: the shared ones and its own."""
        own = self.parts[1 + recording]
        return np.concatenate([np.arange(self.shared), np.arange(own.start, own.stop)])


def make_layout(
    spline: Spline,
    recordings: list[Observations],
    knots: list[int],
    priors: Priors,
    allowances: Sequence[Sequence[Allowance]] = (),
) -> Layout:
    """The vector for several recordings of one beam; `knots` counts the force errors' knots of each, `allowances` are
    those of each."""
    shared = {a.name: a for own in allowances for a in own if a.shared}
    first = recordings[0]
    tags = [f"tag {i}" for i in first.tag_id]
    placement = first.stated.placement_sd if priors.placement is None else priors.placement
    mounting = first.stated.turn_sd if priors.mounting is None else priors.mounting
    curvature = max(curvature_sd(r, priors) for r in recordings)
    heavy = any(needs_mass(r) for r in recordings)
    guessed = [r.stated.mass_sd for r in recordings if np.isfinite(r.stated.mass_sd)]
    mass = max(guessed, default=_weighed_sd(recordings, priors))
    wanted: list[tuple[str, int, str, float | Array, tuple[str, ...]]] = [
        ("stiffness", -1, "log(N m)", 1.0, tuple(f"c{i}" for i in range(spline.count))),
        ("curvature", -1, "rad", curvature, tuple(f"q0 {i}" for i in _REST)),
        ("mass", -1, "1", mass if heavy else 0.0, ("mass", "mass slope", "mass bow", "mass third")),
        ("along", -1, "m", placement, tuple(f"{t} along" for t in tags)),
        ("across", -1, "m", placement, tuple(f"{t} across" for t in tags)),
        ("turn", -1, "rad", mounting, tuple(f"{t} turn" for t in tags)),
        *((a.name, -1, a.unit, a.prior_sd, a.labels) for a in shared.values()),
    ]
    for r, one in enumerate(recordings):
        name = one.source.name
        own = [a for a in allowances[r] if not a.shared] if allowances else []
        origin = one.stated.placement_sd if priors.origin is None else priors.origin
        wanted += [
            ("clamp", r, "rad", clamp_sd(one, priors), (f"{name}: clamp angle",)),
            ("origin", r, "m", origin, (f"{name}: origin x", f"{name}: origin y")),
            ("scale", r, "1", scale_sd(one, priors), (f"{name}: camera scale",)),
            ("clock", r, "s", _clock_sd(one, priors), (f"{name}: clock offset",)),
            ("place", r, "m", _pushed(one, one.stated.place_sd, priors.place), (f"{name}: push place",)),
            ("direction", r, "rad", _pushed(one, one.stated.direction_sd, priors.direction), (f"{name}: force axes",)),
            *((a.name, r, a.unit, a.prior_sd, tuple(f"{name}: {label}" for label in a.labels)) for a in own),
            ("rest change", r, "rad", rest_change_sd(recordings, r), tuple(f"{name}: q0 {i}" for i in _REST)),
            ("zero", r, "m", one.length, _zeros(one)),
            ("end", r, "m", END_SD[0] * one.length, _ends(one, "x", "y")),
            ("end turn", r, "rad", END_SD[1], _ends(one, "angle")),
            ("force", r, "N", 1.0, tuple(f"{name}: force error {a}{i}" for i in range(knots[r]) for a in "xy")),
        ]
    blocks, start = [], 0
    for name, r, unit, sd, labels in wanted:
        sds = np.full(len(labels), sd)
        free = len(labels) > 0 and bool(np.all(sds > 0.0))
        if name == "mass":
            sds[1:] = _mass_spread(recordings, priors)
        blocks.append(Block(name, r, unit, sds, labels, start if free else -1))
        start += len(labels) if free else 0
    index = {(b.name, b.recording): b for b in blocks}
    return Layout(spline, tuple(blocks), start, index, known_shape(recordings))


def clamp_sd(one: Observations, priors: Priors) -> float:
    """rad, of the clamp's direction in the recording's frame before the data.

    The frame's x axis is the line through the tags at rest: it is off by what their places are, and the fit knows those
    from the same frames, so twice that spread is left to it. Where the beam is curved at rest, or rest was not seen,
    no more is known than how well a base tag is put on. Of poses the stated sd is all. 0 freezes it.
    """
    stated = one.stated.clamp_sd if priors.clamp is None else priors.clamp
    if stated == 0.0 or (one.static and np.isfinite(stated)):
        return stated
    own = stated if np.isfinite(stated) else CLAMP_SD
    reach = one.length * one.marker_s[np.isfinite(one.rest_xy).all(axis=1)]
    if curvature_sd(one, priors) > 0.0 or not np.any(reach > 0.0):
        return float(np.hypot(own, MOUNTING_SD))
    placement = one.stated.placement_sd if priors.placement is None else priors.placement
    return float(np.hypot(own, 2.0 * placement / np.linalg.norm(reach)))


def curvature_sd(one: Observations, priors: Priors) -> float:
    """rad, of the Legendre states of q0 before the data; 0 where the beam is straight at rest."""
    if one.stated.rest == "straight":
        return 0.0
    return one.stated.curvature_sd if priors.curvature is None else priors.curvature


def rest_change_sd(recordings: Sequence[Observations], r: int) -> float:
    """rad, of the Legendre states of q0 that a recording has of its own; 0 where there is one recording alone, or where
    nobody says that the beam's rest changed."""
    return recordings[r].stated.rest_change_sd if len(recordings) > 1 else 0.0


def rest_curvature(layout: Layout, x: Array, recording: int) -> Array:
    """(3,) rad, Legendre states of q0 in one recording."""
    return np.asarray(layout.get(x, "curvature") + layout.get(x, "rest change", recording))


def log_axes(layout: Layout, x: Array, recording: int) -> Array:
    """(2, 2) by which the logged force is turned."""
    turn = float(layout.get(x, "direction", recording)[0])
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([[cos, -sin], [sin, cos]])


def scale_sd(one: Observations, priors: Priors) -> float:
    """Of lengths in the picture before the data; a calibration gives them exactly, unless the recording says other."""
    if one.source.view is None:
        return 0.0
    usual = 0.0 if one.source.view.calibrated else SCALE_SD
    stated = one.stated.scale_sd if np.isfinite(one.stated.scale_sd) else usual
    return stated if priors.scale is None or one.source.view.calibrated else priors.scale


def _ends(one: Observations, *what: str) -> tuple[str, ...]:
    """Labels of the ends that an unknown wrench holds, pose by pose."""
    held = np.zeros(0, dtype=int) if one.held is None else np.flatnonzero(one.held)
    return tuple(f"{one.source.name}: held end {i + 1} {name}" for i in held.tolist() for name in what)


def _zeros(one: Observations) -> tuple[str, ...]:
    """Labels of the readings that count from a zero of their own."""
    return tuple(f"{one.source.name}: zero of point {one.tag_id[i]} {'xy'[c]}" for i, c in zeroed_coordinates(one))


def _weighed_sd(recordings: list[Observations], priors: Priors) -> float:
    """Of a mass that is written down, over itself; its parts stay free where it is exact."""
    stated = [r.stated.weighed_sd for r in recordings if np.isfinite(r.stated.weighed_sd)]
    return max(min(stated), _EXACT) if stated else priors.mass


def _mass_spread(recordings: list[Observations], priors: Priors) -> float:
    if any(r.stated.mass_along != "unknown" for r in recordings):
        return _STATED
    return priors.mass_line if any(r.stated.mass_line is not None for r in recordings) else priors.mass_spread


def _clock_sd(one: Observations, priors: Priors) -> float:
    if priors.clock is not None:
        return priors.clock
    if one.source.clock is None:
        return 0.0
    return _CLOCK_DOUBT * float(one.source.clock.sd) if np.isfinite(one.source.clock.sd) else 1.0


def _pushed(one: Observations, said: float, wanted: float | None) -> float:
    """One sd of what a push may be off by; 0 where nothing pushed, or where loads were hung on at marks."""
    if one.static or not np.any(one.force != 0.0):
        return 0.0
    return said if wanted is None else wanted
