"""What the experimenter has: tags, camera and force sensor as good as the recordings so far showed them to be."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from onebend.beam.setup import PARTS, SetUp, posture_terms
from onebend.errors import LearningError
from onebend.learning.allowances import BETWEEN, BETWEEN_SD, TIMES, USUAL_THICKNESS, course_of
from onebend.learning.fit_data import FitData
from onebend.learning.force_error import expected_noise, filtered
from onebend.learning.frames import moved_by, read_alone
from onebend.learning.linear import Hyperparameters, log_k_map
from onebend.learning.parameters import STATED_ERRORS, Layout
from onebend.progress import one_blas_thread
from onebend.record_data import record_from
from onebend.recording.signals import nan_median
from onebend.records import DIRECTION_SD, GAIN_SD, PLACE_SD, POINT_ID, Array, Observations, covariance_with_camera

if TYPE_CHECKING:  # for the type alone: who reads a model loads no fit
    from onebend.learning.posterior import Posterior

_OF_BEFORE = ("shared_mean", "discrepancy")  # keys in models of before; the set-up has them now
SHARED = tuple(error.name for error in STATED_ERRORS if error.shared)  # what all pushes have in common, beside k(s)


@dataclass(frozen=True)
class PlannedPush:
    """A force at one place and in one direction that grows evenly from nothing."""

    at_s: float
    direction: float  # rad, of the force ON the beam in the beam's frame: pi / 2 is to the beam's left
    largest: float  # N


@dataclass(frozen=True)
class ForceDoubt:
    """One sd of what is wrong with the force of a push, each axis alike; the parts of `records.ForceNoise`."""

    level: float  # N, what a tare may miss altogether
    coloured: float  # N, before the low-pass
    tau: float  # s, its correlation time
    cutoff: float | None  # Hz, of the zero-phase low-pass; None: none
    walk: float  # N / sqrt(s)
    frame: float  # N, of each frame on its own
    load: float = 0.0  # N, what comes with the load; no rest shows it

    def times(self, factor: float) -> ForceDoubt:
        """Of a sensor whose every error is `factor` times as large."""
        sizes = {name: factor * float(getattr(self, name)) for name in ("level", "coloured", "walk", "frame", "load")}
        return replace(self, **sizes)

    def covariance(self, lag: Array) -> Array:
        """N^2 of the coloured part at `lag` [s], behind the low-pass."""
        size: Array = np.round(np.abs(lag), 9).astype(np.float64)
        different, back = np.unique(size, return_inverse=True)
        behind = filtered(different, np.inf if self.cutoff is None else self.cutoff)
        return np.asarray(behind.covariance(self.coloured, self.tau)[back].reshape(np.shape(lag)))


@dataclass(frozen=True, kw_only=True)
class Instruments:
    """All that decides what one more push would tell. m tags, p coefficients of log k, N shared nuisances."""

    length: float  # m
    tags: tuple[float, ...]  # (m,) places along the beam
    tag_sd: Array  # (m, 3) m, m, rad: x, y, angle of one frame, widened for the noise's correlation in time
    frames: int  # of a push
    seconds: float  # that a push takes
    rest_before: float  # s of force log without a force, before the push
    rest_after: float  # s, after it
    placement_sd: float  # m, a tag's place along and across the beam, before any data
    turn_sd: float  # rad, a tag's turn on the beam
    curvature_sd: float  # rad, states of the rest shape; 0 where the beam is straight
    mass_sd: float = 0.0  # of the mass; 0 where nothing weighs
    mass_spread_sd: float = 0.0  # of the mass: parts of an uneven mass per metre
    clamp_sd: float  # rad, the clamp's direction, anew in every push
    origin_sd: float  # m, the clamp's place against the base tag
    scale_sd: float = 0.0  # of lengths in the picture; 0 with a calibrated camera
    clock_sd: float  # s
    force: ForceDoubt
    gain_sd: float  # of the force's common scale
    gravity: tuple[float, float] = (0.0, 0.0)  # m/s^2 in the beam's frame
    curvature: float  # rad, the largest |q - q0| so far
    pushes: tuple[PlannedPush, ...] = ()  # made so far
    shared: tuple[str, ...]  # which of `SHARED` are unknown, in that order
    shared_slope: Array  # (N, p) of their mean with the coefficients
    shared_covariance: Array  # (N, N) of what is left of them once the coefficients are known
    place_sd: float = PLACE_SD  # m, a push's place along the beam, anew in every push
    direction_sd: float = DIRECTION_SD  # rad, the force log's axes against the beam's, likewise

    def __post_init__(self) -> None:
        m, count = len(self.tags), self.shared_size
        shapes = (self.tag_sd.shape, self.shared_covariance.shape, self.shared_slope.shape[:1])
        if m == 0 or shapes != ((m, 3), (count, count), (count,)):
            raise LearningError(f"a bench of {m} tags and {count} shared nuisances cannot hold arrays of {shapes}")
        if not (self.frames > 0 and self.seconds > 0.0 and np.all(self.tag_sd > 0.0) and self.force.tau > 0.0):
            raise LearningError("a bench needs frames, seconds, the tags' sd and the force's tau above zero")

    @property
    def shared_size(self) -> int:
        """N."""
        return sum(self._sizes)

    @property
    def shared_parts(self) -> dict[str, slice]:
        """Where each of `shared` stands among the N."""
        ends = np.cumsum([0, *self._sizes]).tolist()
        return {name: slice(a, b) for name, a, b in zip(self.shared, ends[:-1], ends[1:], strict=True)}

    @property
    def _sizes(self) -> list[int]:
        return [{"curvature": 3, "mass": 4}.get(name, len(self.tags)) for name in self.shared]

    def joint(self, covariance: Array) -> Array:
        """(p + N, p + N) covariance of coefficients and shared nuisances, from that of the coefficients (p, p)."""
        across = self.shared_slope @ covariance
        return np.block([[covariance, across.T], [across, across @ self.shared_slope.T + self.shared_covariance]])

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in asdict(self).items()}

    @staticmethod
    def from_dict(data: dict[str, Any]) -> Instruments:
        """From `as_dict`. Raises `LearningError` where an entry is missing, unknown or not as it must be."""
        try:
            bench = record_from(Instruments, {name: one for name, one in data.items() if name not in _OF_BEFORE})
            _check(bench)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise LearningError(f"describes no bench ({error})") from error
        return bench


@one_blas_thread
def instruments_of(posterior: Posterior) -> Instruments:
    """The bench behind a fit; medians where recordings differ. Raises `LearningError` if no force log shows a push."""
    at, films, scales = posterior.layout, posterior.recordings, posterior.optimum.hyperparameters
    seen = [read_alone(f.observations) for f in films]
    names = tuple(name for name in SHARED if at.index[name, -1].start >= 0)
    slope, left = _given_coefficients(posterior, names)
    tag_sd = [n.marker * _tag_sd(o) for o, n in zip(seen, scales.noise, strict=True)]
    bent = [np.max(np.abs(p.solved.q - p.solved.problem.q0)) for p in posterior.optimum.predictions]
    gravity = np.mean([np.mean(o.gravity, axis=0) for o in seen], axis=0)
    rests = np.median([_rests(o) for o in seen], axis=0)
    return Instruments(
        length=seen[0].length,
        tags=tuple(float(s) for s in seen[0].marker_s),
        tag_sd=nan_median(np.asarray(tag_sd)),
        frames=round(float(np.median([np.sum(f.frames) for f in films]))),
        seconds=float(np.median([np.ptp(f.observations.time[f.frames]) for f in films])),
        rest_before=float(rests[0]),
        rest_after=float(rests[1]),
        **{error.field: _prior_sd(at, films, error.name, shared=error.shared) for error in STATED_ERRORS},
        mass_spread_sd=_prior_sd(at, films, "mass", shared=True, part=-1),
        force=_force_doubt(films, scales),
        gain_sd=posterior.gain_sd,
        gravity=(float(gravity[0]), float(gravity[1])),
        curvature=float(max(bent)),
        pushes=tuple(push_of(o) for o in seen),
        shared=names,
        shared_slope=slope,
        shared_covariance=left,
    )


def instruments_if_pushed(posterior: Posterior) -> Instruments | None:
    """`instruments_of`, or None where no recording has a force log with a push."""
    return instruments_of(posterior) if any(len(f.error.knots) for f in posterior.recordings) else None


def push_of(observations: Observations) -> PlannedPush:
    """The push of a recording: its largest force, and the mean direction of what often turns with the beam."""
    size = np.where(observations.loaded, np.linalg.norm(observations.force, axis=1), np.nan)
    if not np.any(np.isfinite(size)):
        return PlannedPush(1.0, 0.0, 0.0)
    top = int(np.nanargmax(size))
    x, y = np.mean(observations.force[np.isfinite(size)], axis=0)
    place = float(observations.push_s[top])
    return PlannedPush(place if np.isfinite(place) else 1.0, float(np.arctan2(y, x)), float(size[top]))


def _given_coefficients(posterior: Posterior, names: tuple[str, ...]) -> tuple[Array, Array]:
    """Slope (N, f) and left covariance (N, N) of the shared nuisances, given the f coefficients of log k's band."""
    index = posterior.layout.index
    first, onto = log_k_map(posterior.problem)
    rest = [np.arange(posterior.layout.size)[index[name, -1].where] for name in names]
    others = np.concatenate([np.zeros(0, dtype=np.int64), *rest])
    covariance = posterior.covariance.of_shared
    across = covariance[np.ix_(others, first)] @ onto.T
    slope = across @ np.linalg.pinv(posterior.stiffness.covariance, rcond=1e-11, hermitian=True)
    left = covariance[np.ix_(others, others)] - slope @ across.T
    return slope, np.asarray(0.5 * (left + left.T))


def _discrepancy(films: tuple[FitData, ...], scales: Hyperparameters) -> tuple[float, float]:
    """1 and rad/m, as large as the evidence chose it; 0 where the fit has none."""
    sds = {a.name: float(a.prior_sd[0]) for film in films for a in film.allowances if len(a.prior_sd)}
    moved = [float(np.nanmax(moved_by(f.observations), initial=0.0)) for f in films]
    # at the largest displacement the squares of its functions of the bending add up to this
    size = np.sqrt(2.5) / max(float(np.median(moved)), np.finfo(float).tiny)
    place, angle = (sds.get(name, 0.0) * scales.sizes.get(name, 1.0) for name in ("discrepancy", "angle discrepancy"))
    return size * place, size * angle


def _force_doubt(films: tuple[FitData, ...], scales: Hyperparameters) -> ForceDoubt:
    pushed = [(f, n) for f, n in zip(films, scales.noise, strict=True) if len(f.error.knots)]
    if not pushed:
        raise LearningError("no recording has a force log with a push, so nothing says how well a force can be known")
    noises = [expected_noise(f.observations, push_of(f.observations).largest) for f, _ in pushed]
    logs = [f.observations.source.clean_force for f, _ in pushed]
    cutoffs = [log.cutoff for log in logs if log is not None and np.isfinite(log.cutoff)]
    return ForceDoubt(
        level=float(np.median([f.error.noise.level for f, _ in pushed])),
        coloured=scales.coloured * float(np.median([n.coloured for n in noises])),
        tau=scales.memory * float(np.median([n.tau for n in noises])),
        cutoff=float(np.median(cutoffs)) if cutoffs else None,
        walk=scales.walk * float(np.median([n.walk for n in noises])),
        frame=float(np.median([n.force for _, n in pushed])),
        load=scales.load * float(np.median([f.error.noise.load for f, _ in pushed])),
    )


def _prior_sd(at: Layout, films: tuple[FitData, ...], name: str, *, shared: bool, part: int = 0) -> float:
    blocks = [at.index[name, number] for number in ([-1] if shared else [f.number for f in films])]
    return float(np.median([b.prior_sd[part] if b.start >= 0 else 0.0 for b in blocks]))


def _tag_sd(observations: Observations) -> Array:
    """(m, 3) of x, y, angle in a typical frame."""
    return np.sqrt(nan_median(np.diagonal(covariance_with_camera(observations), axis1=2, axis2=3)))


def _rests(observations: Observations) -> tuple[float, float]:
    clean, loaded = observations.source.clean_force, observations.time[observations.loaded]
    if clean is None or len(loaded) == 0:
        return 0.0, 0.0
    before = 0.0 if observations.loaded[0] else max(float(loaded[0] - clean.time[0]), 0.0)
    after = 0.0 if observations.loaded[-1] else max(float(clean.time[-1] - loaded[-1]), 0.0)
    return before, after


def _check(bench: Instruments) -> None:
    """Raises `ValueError` for what no onebend writes."""
    for record in (bench, bench.force):
        for item in fields(record):
            value = getattr(record, item.name)
            if isinstance(value, float | int | np.ndarray) and not np.all(np.isfinite(value)):
                raise ValueError(f"{item.name} is not finite")
    for name, count, low, high in (
        ("tags", len(bench.tags), 0.0, 1.0),
        ("gravity", 2, -np.inf, np.inf),
    ):
        value = np.asarray(getattr(bench, name), dtype=float)
        if value.shape != (count,) or not np.all(np.isfinite(value) & (low <= value) & (value <= high)):
            raise ValueError(f"{name} is not as it must be")
    if not set(bench.shared) <= set(SHARED):
        raise ValueError("shared names no nuisances")


_HELD = 0.99  # of the largest force: the last frame with more ends the hold
_KEPT = 1e-11  # of the largest eigenvalue of log k's covariance: directions below are fixed


@one_blas_thread
def setup_of(posterior: Posterior) -> SetUp | None:
    """The set-up of the last recording, jointly with log k; None of poses, or where no force log shows a push."""
    number = len(posterior.recordings) - 1
    data, at = posterior.recordings[number], posterior.layout
    o = read_alone(data.observations)
    run = course_of(o, data.frames)
    if o.static or not len(data.error.knots):
        return None
    sizes: dict[str, int] = {}
    rows, mean, prior_sd = [_coefficient_rows(posterior)], [np.zeros(0)], [np.zeros(0)]
    stiffness, unlike = posterior.stiffness, {"log k": BETWEEN, "force error": ""}

    def add(name: str, where: slice, weights: Array, before: Array) -> None:
        sizes[name] = len(weights)
        rows.append((where, weights))
        mean.append(weights @ posterior.mean[where])
        prior_sd.append(before)

    for name in PARTS:
        keys = ((unlike.get(name, name), whose) for whose in (-1, number))
        block = next((at.index[key] for key in keys if key in at.index and at.index[key].start >= 0), None)
        if block is not None:
            add(name, block.where, np.eye(len(block.prior_sd)), block.prior_sd)
    size = np.linalg.norm(data.force, axis=1)
    largest, held = int(np.nanargmax(size)), int(np.flatnonzero(size > _HELD * np.nanmax(size))[-1])
    if recurring := _force_error_rows(posterior, number, posture_terms(run.moved)):
        add("force error", *recurring)
    joint, p = posterior.covariance.of_functionals(rows), len(stiffness.mean)
    slope = joint[p:, :p] @ np.linalg.pinv(joint[:p, :p], rcond=_KEPT, hermitian=True)
    covariance = joint[p:, p:] - slope @ joint[:p, p:]
    exact = {"gain": np.hypot(posterior.gain_sd, max(posterior.gain_sd, GAIN_SD)) * np.ones(1), "log k": BETWEEN_SD}
    for name, before in exact.items():  # of this set-up they are part of log k
        if name not in sizes:
            sizes[name] = len(before)
            mean.append(np.zeros(len(before)))
            prior_sd.append(before)
            covariance = np.pad(covariance, (0, len(before)))
            slope = np.pad(slope, ((0, len(before)), (0, 0)))
    stated = o.stated.thickness
    scales = posterior.optimum.hyperparameters
    left_over = _discrepancy(posterior.recordings, scales)
    return SetUp(
        push_s=float(data.push_s[largest]),
        force=(float(data.force[largest, 0]), float(data.force[largest, 1])),
        tags=tuple(float(s) for s in o.marker_s),
        thickness=stated if np.isfinite(stated) else USUAL_THICKNESS * o.length,
        sizes=sizes,
        mean=np.concatenate(mean),
        slope=slope,
        covariance=0.5 * (covariance + covariance.T),
        prior_sd=np.concatenate(prior_sd),
        force_sd=float(np.hypot(_slow_error(posterior, number, largest), scales.noise[number].force)),
        discrepancy=left_over[0],
        angle_discrepancy=left_over[1],
        times=tuple(TIMES.tolist()) if "relaxation" in sizes else (),
        reached=posterior.optimum.predictions[number].reached(),
        reached_at_largest=posterior.optimum.predictions[number].reached(held),
        tag_ids=tuple(int(i) if i < POINT_ID else -1 for i in o.tag_id),
    )


def _coefficient_rows(posterior: Posterior) -> tuple[slice, Array]:
    """The coefficients of log k's band as functions of the shared parameters."""
    index, onto = log_k_map(posterior.problem)
    weights = np.zeros((len(onto), posterior.layout.shared))
    weights[:, index] = onto
    return slice(0, posterior.layout.shared), weights


_LASTING = ("posture", "rub")  # errors of the force in a held push: lag and hysteresis end with the motion


def _force_error_rows(posterior: Posterior, number: int, terms: Array) -> tuple[slice, Array, Array] | None:
    """The error of the force that recurs in each push: that of the posture, and others by the polynomial nearest to
    them, in the displacement of the pushed place: `terms` (F, 5). Slow errors of one log do not recur.

    Returns where the parameters stand, the polynomial's coefficients (10,) as functions of them, and the sds of these
    coefficients before the data; None where no such error was allowed for.
    """
    data, at = posterior.recordings[number], posterior.layout
    again = [a for a in data.entering("force") if a.name in _LASTING and at.index[a.name, number].start >= 0]
    prior_sd = next((a.prior_sd for a in again if a.name == "posture"), None)
    if prior_sd is None:
        return None
    blocks = [at.index[a.name, number] for a in again]
    first, last = min(b.where.start for b in blocks), max(b.where.stop for b in blocks)
    weights = np.zeros((len(prior_sd), last - first))
    for allowance, block in zip(again, blocks, strict=True):
        if allowance.name == "posture":
            mine = np.eye(block.count)
        else:
            nearest = np.einsum("if,fcp->cip", np.linalg.pinv(terms), allowance.basis[: len(terms)])
            mine = nearest.reshape(len(weights), -1)
        weights[:, block.start - first :][:, : block.count] = mine
    return slice(first, last), weights, prior_sd


def _slow_error(posterior: Posterior, number: int, frame: int) -> float:
    """N, sd of the slow error of the log in this frame of a push, after the sensor was zeroed in the rest before."""
    own, h = posterior.recordings[number].error, posterior.optimum.hyperparameters
    now = own.weights[frame]
    before = own.rest_weights[own.rest_weights @ own.knots < now @ own.knots]  # the splines sum to the time, too
    since_rest = now - (np.mean(before, axis=0) if len(before) else 0.0)
    return float(np.sqrt(since_rest @ own.covariance(h.coloured, h.memory, h.walk, h.load) @ since_rest))
