"""Which push to make next: Fisher information, candidates, and what each would leave of the band."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline

from onebend.beam import continuation, grid, loads, sensitivity, statics
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.stiffness import IDENTIFIED_SD, LogSpline, Profile, UncertainStiffness, half_width
from onebend.errors import LearningError, MechanicsError
from onebend.learning import fit_data, outcome, parameters, prediction
from onebend.learning.instruments import ForceDoubt, Instruments, PlannedPush
from onebend.options import POSITIVE, option
from onebend.progress import Progress, Silent, one_blas_thread, track
from onebend.records import Array, BoolArray, IntArray, unit

# Fisher information of one push. With J the derivatives of the tags' poses with the parameters and A those with the
# force, it is `J' (D + A E A')^-1 J`: D the tags' noise, E the force error that the rests leave. Nuisances of this push
# alone are eliminated by a Schur complement with their prior.

STEPS = 24  # frames that stand for all of a push
RESOLUTION = Resolution(order=12, widest=0.5)
_INSTANTS = 4  # of a step, over which the force's error is averaged
_MOST_RESTS = 80  # instants of a rest that count: what is farther from the push tells nothing new
_REST_SHARE = 0.1  # of the coloured doubt: how well the log in a rest shows the error there


@dataclass(frozen=True)
class TagDerivatives:
    """Derivatives of tags' poses along one push: F frames, the last being the beam at rest; M places of tags."""

    made: PlannedPush
    tags: Array  # (M,) the bench's own first
    tip: Array  # (F, 3) m, m, rad: its pose
    blocks: dict[str, Array]  # (F, M, 3, n) of what bends the beam, by name
    motion: prediction.TagMotion  # with what holds the tags

    @property
    def push(self) -> Array:
        """(F, M, 3, 2) per N, with each frame's force; zero at rest."""
        return self.blocks["push"]


def loads_of(bench: Instruments, at_s: float, forces: Array) -> loads.Loads:
    """Forces (F, 2) N at one place, under the bench's gravity."""
    return loads.push(forces, at_s) + loads.weight(bench.gravity)


def solve_push(beam: Beam, bench: Instruments, candidate: PlannedPush) -> statics.Equilibrium:
    """The push in `STEPS` steps, each in the middle of its share, and the beam at rest. Raises `MechanicsError` if it
    buckles or snaps through."""
    solved = continuation.follow(make_problem(beam, loads_of(bench, candidate.at_s, _forces(candidate)), RESOLUTION))
    if not np.all(solved.stable & np.isnan(solved.buckled_at)):
        raise MechanicsError(
            f"pushed at s = {candidate.at_s:.2f} to {candidate.largest:.3g} N the beam buckles or snaps through; "
            "a smaller force or another direction is needed"
        )
    return solved


def _forces(candidate: PlannedPush) -> Array:
    """(F, 2) N in the steps of a push, and none at rest."""
    steps = np.append((np.arange(STEPS) + 0.5) / STEPS, 0.0)
    return candidate.largest * steps[:, None] * unit(candidate.direction)


def tag_derivatives(
    beam: Beam, bench: Instruments, candidate: PlannedPush, basis: Callable[[Array], Array], more: Array | None = None
) -> TagDerivatives:
    """Of the bench's tags, and of tags at `more` places, with coefficients of log k on this `basis` (S,) -> (S, C), and
    with all else. Raises `MechanicsError` if the beam buckles or snaps through."""
    solved, tags = solve_push(beam, bench, candidate), np.array(bench.tags)
    tags = tags if more is None else np.append(tags, more)
    problem, nodes = solved.problem, solved.problem.grid.nodes
    per_length = _mean_of(beam.mass_per_length) * fit_data.MASS_MODES.curvature(nodes)
    pushed, push_s = _forces(candidate), np.asarray(candidate.at_s)
    _, across = prediction.along_and_across(pushed, solved.angle(push_s[None])[:, 0])
    bent = prediction.BentBeam(
        solved,
        basis(nodes),
        fit_data.REST_MODES.curvature(nodes),
        pushed,
        np.any(pushed != 0.0, axis=1)[:, None] * np.asarray(nodes < push_s, dtype=float),
        np.zeros_like(nodes),
        sensitivity.of_mass(problem, per_length, np.asarray(bench.gravity)[None]),
    )
    changes = prediction.load_changes(bent) | {"place": prediction.push_moment(problem, push_s, across)}
    blocks = prediction.place_responses(solved, prediction.response_columns(changes, bent), tags)
    pushes = prediction.push_forces(pushed, np.eye(2), np.zeros_like(pushed))
    blocks |= {name: blocks["push"] @ force[:, None] for name, force in pushes.items()}
    poses = solved.poses(np.append(tags, 1.0))
    bend = grid.apply(problem.grid.value_at(tags), solved.q) / bench.length
    nothing = np.zeros(len(tags))
    motion = prediction.TagRide(poses[:, :-1, 2], nothing, nothing).motion(poses[:, :-1, :2], bend)
    return TagDerivatives(candidate, tags, poses[:, -1], blocks, motion)


def _mean_of(profile: Profile) -> float:
    x, w = np.polynomial.legendre.leggauss(32)
    return float(0.5 * w @ np.asarray(profile(0.5 * (x + 1.0))))


def joint_information(seen: TagDerivatives, bench: Instruments, more: int | None = None) -> Array:
    """(C + N, C + N) of coefficients and shared nuisances, by the bench's own tags, and tag number `more` of `seen`."""
    own = len(bench.tags)
    chosen = np.arange(own) if more is None else np.append(np.arange(own), more)
    jacobian, own_sd = _columns(seen, bench, chosen)
    frames, rows, columns = len(jacobian), 3 * len(chosen), jacobian.shape[-1]
    sd = bench.tag_sd[np.minimum(np.arange(len(chosen)), own - 1)].ravel()
    counts = np.append(np.full(frames - 1, bench.frames / (frames - 1)), 1.0)
    root = np.sqrt(counts)[:, None] / sd  # (F, R)
    j = root[..., None] * jacobian.reshape(frames, rows, columns)
    a = root[:-1, :, None] * seen.push[:-1, chosen].reshape(frames - 1, rows, 2)
    flat = j.reshape(-1, columns)
    aj = (np.swapaxes(a, 1, 2) @ j[:-1]).reshape(-1, columns)  # (2 (F - 1), columns)
    information = flat.T @ flat - aj.T @ _doubt_left(a, force_covariance(bench, seen.made)) @ aj
    return eliminate(information, len(own_sd), 1.0 / own_sd**2)


@one_blas_thread
def information(beam: Beam, bench: Instruments, candidate: PlannedPush) -> Array:
    """(p, p) Fisher information of one push on the coefficients of log k, all nuisances marginalised, as on a bench
    without earlier pushes. Raises `LearningError` without a log-spline, `MechanicsError` without a stable equilibrium.
    """
    stiffness = beam.stiffness
    if not isinstance(stiffness, LogSpline):
        raise LearningError("information is on the coefficients of a log-spline; give the beam such a stiffness")
    knots, degree = np.asarray(stiffness.knots), stiffness.degree
    seen = tag_derivatives(beam, bench, candidate, lambda s: BSpline.design_matrix(s, knots, degree).toarray())
    return eliminate(joint_information(seen, bench), bench.shared_size, alone(bench))


def force_covariance(bench: Instruments, candidate: PlannedPush) -> Array:
    """(2 STEPS, 2 STEPS) N^2 of the force error in the steps, x and y in turn, after the rests. A clock error acts as a
    force along the push."""
    one = _doubt_of_axis(bench.force, bench.seconds, bench.rest_before, bench.rest_after)
    one = one + np.eye(STEPS) * bench.force.frame**2 * STEPS / bench.frames
    rate = np.tile(candidate.largest / bench.seconds * unit(candidate.direction), STEPS)
    return np.asarray(np.kron(one, np.eye(2)) + bench.clock_sd**2 * np.outer(rate, rate))


@lru_cache(maxsize=8)
def _doubt_of_axis(doubt: ForceDoubt, seconds: float, before: float, after: float) -> Array:
    """(STEPS, STEPS) N^2 of the mean force error in each step: level, coloured part and random walk, given the log in
    the rests, and a constant that comes with the load."""
    apart = seconds / (STEPS * _INSTANTS)
    inside = apart * (np.arange(STEPS * _INSTANTS) + 0.5)
    earlier, later = (apart * np.arange(1, rest / apart)[:_MOST_RESTS] for rest in (before, after))
    rests = np.concatenate([-earlier, seconds + later])
    every = np.concatenate([inside, rests])
    since = every - every.min()
    full = doubt.covariance(every[:, None] - every) + doubt.walk**2 * np.minimum(since[:, None], since)
    full += doubt.level**2
    count = len(inside)
    left = full[:count, :count]
    if len(rests):
        seen = full[count:, count:] + _REST_SHARE**2 * doubt.covariance(np.zeros(1)) * np.eye(len(rests))
        left = left - full[:count, count:] @ np.linalg.solve(seen, full[count:, :count])
    left = left + doubt.load**2
    mean = np.kron(np.eye(STEPS), np.full((1, _INSTANTS), 1.0 / _INSTANTS))
    return np.asarray(mean @ left @ mean.T)


def eliminate(information: Array, last: int, prior: Array | float = 0.0) -> Array:
    """Information on all but the `last` parameters, these being unknown but for their prior precisions (last,)."""
    if last == 0:
        return information
    kept = len(information) - last
    across = information[:kept, kept:]
    out = information[:kept, :kept] - across @ np.linalg.solve(
        information[kept:, kept:] + np.diag(np.broadcast_to(prior, last)), across.T
    )
    return np.asarray(0.5 * (out + out.T))


def alone(bench: Instruments) -> Array:
    """(N,) prior precisions of the shared nuisances before any push."""
    field, parts = {error.name: error.field for error in parameters.STATED_ERRORS}, bench.shared_parts
    sds = np.zeros(bench.shared_size)
    for name, where in parts.items():
        sds[where] = getattr(bench, field[name])
    if "mass" in bench.shared:
        sds[parts["mass"]][1:] = bench.mass_spread_sd
    return np.asarray(sds**-2.0)


def with_better_sensor(bench: Instruments, times: float) -> Instruments:
    """The bench with a force sensor whose every error is `times` smaller."""
    return replace(bench, force=bench.force.times(1.0 / times), gain_sd=bench.gain_sd / times)


def _columns(seen: TagDerivatives, bench: Instruments, chosen: IntArray) -> tuple[Array, Array]:
    """Derivatives (F, R / 3, 3, C + N + O) and the prior sd (O,) of the O nuisances of this push alone."""
    own, motion = len(bench.tags), seen.motion
    watched = prediction.TagMotion(*(part[:, chosen] for part in (motion.along, motion.bend, motion.across, motion.xy)))
    blocks = {name: block[:, chosen] for name, block in seen.blocks.items()} | prediction.tag_blocks(watched)
    of_tags = [error.name for error in parameters.STATED_ERRORS if error.of_tags]
    shared = [blocks[name][..., :own] if name in of_tags else blocks[name] for name in bench.shared]
    wanted = [
        (blocks[error.name][..., own:] if error.of_tags else blocks[error.name], getattr(bench, error.field))
        for error in parameters.STATED_ERRORS
        if error.of_tags or not error.shared
    ]
    free = [(part, np.full(part.shape[-1], sd)) for part, sd in wanted if sd > 0.0]
    sds = np.concatenate([np.zeros(0), *(sd for _, sd in free)])
    return np.concatenate([blocks["stiffness"], *shared, *(part for part, _ in free)], axis=-1), sds


def _doubt_left(a: Array, covariance: Array) -> Array:
    """`(E^-1 + G)^-1` with G the frames' `A' A`, block-diagonal; no inverse of E."""
    steps = len(a)
    gram = np.zeros((steps, 2, steps, 2))
    gram[np.arange(steps), :, np.arange(steps), :] = np.swapaxes(a, 1, 2) @ a
    left = np.linalg.solve(np.eye(2 * steps) + covariance @ gram.reshape(2 * steps, -1), covariance)
    return np.asarray(0.5 * (left + left.T))


# The largest force within the limits, at every place and in every direction.

_COARSE = np.geomspace(0.02, 40.0, 40)  # forces, in units of what turns a linear beam's loaded place by one radian
BUCKLES = "the beam buckles or snaps through"
_MARGIN = 1.15  # of the force: so far beyond the largest the beam must still stand


@dataclass(frozen=True)
class Limits:
    """What the experimenter allows. Angles in radians."""

    force: float | None = option("--max-force-N", None, within=POSITIVE)  # before the first push no limit
    tip_turn: float | None = option("--max-tip-angle-deg", None, within=(1.0, 180.0))
    curvature: float = 1.25  # times the largest curvature reached so far
    slant: float = np.deg2rad(75.0)  # between the force and the beam's normal: beyond, the tool slips off


@dataclass(frozen=True)
class LargestPush:
    """The largest force at a place in a direction, or why there is none."""

    at_s: float
    direction: float  # rad
    largest: float  # N
    why_not: str = ""


def same_push(one: PlannedPush, other: PlannedPush) -> bool:
    """Whether two pushes are the same to within what a hand can tell."""
    turn = np.angle(np.exp(1j * (one.direction - other.direction)))
    force = abs(one.largest - other.largest) / max(one.largest, other.largest)
    return bool(abs(one.at_s - other.at_s) < 0.03 and abs(turn) < np.deg2rad(10.0) and force < 0.1)


def largest_pushes(
    beam: Beam, bench: Instruments, at_s: tuple[float, ...], directions: Array, limits: Limits
) -> list[LargestPush]:
    """Every place and direction [rad]."""
    return [reach for s in at_s for reach in _reach_at(beam, bench, s, directions, limits)]


def _reach_at(beam: Beam, bench: Instruments, at_s: float, directions: Array, limits: Limits) -> list[LargestPush]:
    unit = _softness(beam, at_s)
    rough = [_first_break(beam, bench, at_s, d, unit * _COARSE, limits) for d in directions]
    out = []
    for direction, (safe, over, why) in zip(directions.tolist(), rough, strict=True):
        if why == BUCKLES or safe == 0.0:
            out.append(LargestPush(at_s, direction, 0.0, why))
            continue
        fine, _, _ = _first_break(beam, bench, at_s, direction, np.linspace(safe, over, 12), limits)
        largest = min(max(safe, fine), _most_force(bench, limits))
        if not _stands(beam, bench, at_s, direction, _MARGIN * largest):
            out.append(LargestPush(at_s, direction, 0.0, BUCKLES))
            continue
        out.append(LargestPush(at_s, direction, largest))
    return out


def _first_break(
    beam: Beam, bench: Instruments, at_s: float, direction: float, sizes: Array, limits: Limits
) -> tuple[float, float, str]:
    forces = np.append(sizes, 0.0)[:, None] * unit(direction)
    solved = continuation.follow(make_problem(beam, loads_of(bench, at_s, forces), RESOLUTION))
    broken = _broken(solved, bench, at_s, direction, limits)
    first = {why: int(np.argmax(rows[:-1])) for why, rows in broken.items() if np.any(rows[:-1])}
    if not first:
        return float(sizes[-1]), float(sizes[-1]), ""
    why = min(first, key=lambda one: first[one])
    at = first[why]
    return (float(sizes[at - 1]) if at else 0.0), float(sizes[at]), why


def _broken(
    solved: statics.Equilibrium, bench: Instruments, at_s: float, direction: float, limits: Limits
) -> dict[str, BoolArray]:
    here, tip = solved.angle(np.array([at_s, 1.0])).T
    turn = np.abs(tip - tip[-1])
    side = 1.0 if np.sin(direction - here[-1]) >= 0.0 else -1.0
    slant = np.abs(np.angle(np.exp(1j * (direction - here - side * 0.5 * np.pi))))
    bent = np.max(np.abs(solved.q - solved.problem.q0), axis=1)
    most_turn = 0.5 * np.pi if limits.tip_turn is None else limits.tip_turn
    curved = bent > limits.curvature * bench.curvature if limits.tip_turn is None else np.zeros(len(bent), dtype=bool)
    return {
        BUCKLES: ~solved.stable | ~np.isnan(solved.buckled_at),
        "the force does not press the beam there, the tool slips off": slant > limits.slant,
        "the smallest push bends the beam beyond the limits": (turn > most_turn) | curved,
    }


def _most_force(bench: Instruments, limits: Limits) -> float:
    if limits.force is not None:
        return limits.force
    return 2.0 * max((p.largest for p in bench.pushes), default=np.inf)


def _stands(beam: Beam, bench: Instruments, at_s: float, direction: float, force: float) -> bool:
    solved = continuation.follow(make_problem(beam, loads_of(bench, at_s, force * unit(direction)[None]), RESOLUTION))
    return bool(solved.stable[0] and np.isnan(solved.buckled_at[0]))


def _softness(beam: Beam, at_s: float) -> float:
    """N that would turn the loaded place of a linear beam by one radian."""
    s = at_s * (np.arange(200) + 0.5) / 200
    return float(1.0 / (beam.length * np.mean((at_s - s) / beam.stiffness(s)) * at_s))


PLACES = np.linspace(0.0, 1.0, 101)  # where the band is looked at
_GAP = 0.1  # in s: a wider gap between tags gets one in its middle


@dataclass(frozen=True)
class Quality:
    """How well k(s) is known. Widths are of the 95 % band of log k."""

    mean_width: float
    worst_width: float
    worst_s: float
    identified: float  # share of the beam
    identified_to: float  # k is identified from the clamp to here


def quality_of(sd: Array, own_sd: Array) -> Quality:
    """Figures of a band of log k whose sd (101,) is `own_sd` without the gain."""
    width, known = 2.0 * half_width(sd), own_sd < IDENTIFIED_SD
    worst, share = int(np.argmax(width)), float(np.mean(known))
    to = 0.0 if not known[0] else 1.0 if np.all(known) else float(PLACES[max(int(np.argmin(known)) - 1, 0)])
    return Quality(float(np.mean(width)), float(width[worst]), float(PLACES[worst]), share, round(to, 2))


@dataclass(frozen=True)
class Proposal:
    """One push, what it needs, and what it would leave of the band."""

    push: PlannedPush
    repeats: bool  # a push made before, once more
    tip_moves: float  # m
    tip_turns: float  # rad
    before: Quality
    after: Quality
    sd: Array  # (101,) of log k at `PLACES` after it
    added_tag: float | None = None  # place of one more tag
    better_sensor: float | None = None  # times smaller errors than today's; None: today's sensor

    @property
    def needs(self) -> outcome.Notice | None:
        """The tag or the sensor that is not on the bench yet."""
        if self.added_tag is not None:
            return outcome.Notice("one more tag", {"s": self.added_tag})
        return None if self.better_sensor is None else outcome.Notice("better sensor", {"times": self.better_sensor})

    @property
    def notice(self) -> outcome.Notice:
        """The push, its needs, and how well k(s) would be known after it."""
        return outcome.Notice("planned push", {**vars(self), "needs": self.needs})


@dataclass(frozen=True)
class Plan:
    """Proposals, what costs nothing first; the best two pushes on today's bench; and what was left out."""

    before: Quality
    sd: Array  # (101,) of log k at `PLACES` now
    proposals: tuple[Proposal, ...]
    pair: tuple[Proposal, ...]  # the second given the first
    left_out: tuple[str, ...]  # sentences


# Candidates ranked by the band afterwards. Their information is added to that on coefficients and shared nuisances.


@dataclass(frozen=True)
class PlanSettings:
    """Which pushes are tried, and how many are proposed."""

    at_s: tuple[float, ...] = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
    directions_deg: tuple[float, ...] = (60.0, 90.0, 120.0, 150.0, -60.0, -90.0, -120.0, -150.0)
    sizes: tuple[float, ...] = (1.0, 0.6)  # as shares of the largest force that the limits allow
    limits: Limits = field(default_factory=Limits)
    better_sensor: float = 5.0  # times smaller errors of a better force sensor
    count: int = option("--count", 8, metavar="N", within=(1, None))
    apart: float = 0.15  # in s: nearer pushes with the same needs count as one


@dataclass(frozen=True)
class _Known:
    covariance: Array  # (p + N, p + N), the common gain apart
    gain_sd: float
    basis: Array  # (101, p)

    def sd(self) -> Array:
        """(101,) of log k, the gain included."""
        return np.asarray(np.hypot(self._own_sd(), self.gain_sd))

    def quality(self) -> Quality:
        return quality_of(self.sd(), self._own_sd())

    def after(self, told: Array) -> _Known:
        """With the information of a push made with the same sensor."""
        return replace(self, covariance=_updated(self.covariance, told))

    def after_other_sensor(self, told: Array, gain_sd: float) -> _Known:
        """With the information of a push made with a sensor of another gain: it tells of today's sensor's gain too."""
        scale = np.append(np.ones(self.basis.shape[1]), np.zeros(len(told) - self.basis.shape[1]))
        if gain_sd > 0.0:
            row = told @ scale
            told = told - np.outer(row, row) / (gain_sd**-2 + scale @ row)
        whole = self.covariance + self.gain_sd**2 * np.outer(scale, scale)
        return _Known(_updated(whole, told), 0.0, self.basis)

    def _own_sd(self) -> Array:
        p = self.basis.shape[1]
        variance = np.einsum("si,ij,sj->s", self.basis, self.covariance[:p, :p], self.basis)
        return np.asarray(np.sqrt(variance))


@one_blas_thread
def plan(
    uncertain: UncertainStiffness,
    beam: Beam,
    bench: Instruments,
    settings: PlanSettings = PlanSettings(),
    *,
    progress: Progress = Silent(),
) -> Plan:
    """Next pushes on a beam with k(s) `uncertain`, ranked by cost, then by the mean width of the band afterwards.
    `beam` gives length, rest shape and mass. Raises `LearningError` if bench and stiffness differ, or no push is
    possible."""
    if bench.shared_slope.shape[1] != len(uncertain.mean) or beam.length != bench.length:
        raise LearningError("the bench does not belong to this stiffness: learn the beam again, and plan from that")
    beam = replace(beam, stiffness=uncertain.profile)
    now = _Known(bench.joint(uncertain.covariance), uncertain.gain_sd, uncertain.basis(PLACES))
    found = largest_pushes(beam, bench, settings.at_s, np.deg2rad(settings.directions_deg), settings.limits)
    left_out = _left_out(found)
    thoughts = list(_thoughts(uncertain, beam, bench, found, settings, progress))
    if not thoughts:
        raise LearningError(f"no push is possible within the limits. {' '.join(left_out)}")
    plain = [_propose(t, now, bench) for t in thoughts]
    other = [p for t in thoughts for p in _with_more(t, now, bench, settings)]
    first = min(plain, key=_left)
    after = now.after(joint_information(thoughts[plain.index(first)], bench))
    second = min((_propose(t, after, bench) for t in thoughts), key=_left)
    ranked = _distinct(sorted([*plain, *other], key=_cost_and_left), settings)
    return Plan(now.quality(), now.sd(), ranked, (first, second), left_out)


def after_push(uncertain: UncertainStiffness, beam: Beam, bench: Instruments, push: PlannedPush) -> UncertainStiffness:
    """k(s) as known after one push with the present sensor, with the same mean. Raises `MechanicsError` without a
    stable equilibrium."""
    seen = tag_derivatives(replace(beam, stiffness=uncertain.profile), bench, push, uncertain.basis)
    told, p = joint_information(seen, bench), len(uncertain.mean)
    return replace(uncertain, covariance=_updated(bench.joint(uncertain.covariance), told)[:p, :p])


def _thoughts(
    uncertain: UncertainStiffness,
    beam: Beam,
    bench: Instruments,
    found: list[LargestPush],
    settings: PlanSettings,
    progress: Progress,
) -> Iterator[TagDerivatives]:
    new = [
        PlannedPush(r.at_s, r.direction, share * r.largest) for r in found if not r.why_not for share in settings.sizes
    ]
    again = [p for i, p in enumerate(bench.pushes) if p.largest > 0.0 and p not in bench.pushes[:i]]
    candidates = [*again, *(p for p in new if not any(same_push(p, a) for a in again))]
    for candidate in track(progress, "trying pushes", candidates, len(candidates)):
        # a push that was made once stands on its way there, but perhaps not when it grows straight
        with suppress(MechanicsError):
            yield tag_derivatives(beam, bench, candidate, uncertain.basis, gaps(bench.tags))


def gaps(tags: tuple[float, ...]) -> Array:
    """s, the middles of wide gaps between tags, and a tip without one."""
    edges = np.concatenate([[0.0], np.sort(tags)])
    middles = 0.5 * (edges[1:] + edges[:-1])[np.diff(edges) > _GAP]
    return np.append(middles, 1.0) if edges[-1] < 1.0 - _GAP else middles


def _propose(seen: TagDerivatives, now: _Known, bench: Instruments, more: int | None = None) -> Proposal:
    return _proposal(seen, now, now.after(joint_information(seen, bench, more)), bench)


def _with_more(seen: TagDerivatives, now: _Known, bench: Instruments, settings: PlanSettings) -> Iterator[Proposal]:
    for i in range(len(bench.tags), len(seen.tags)):
        yield replace(_propose(seen, now, bench, i), added_tag=float(seen.tags[i]))
    better = with_better_sensor(bench, settings.better_sensor)
    after = now.after_other_sensor(joint_information(seen, better), better.gain_sd)
    yield replace(_proposal(seen, now, after, bench), better_sensor=settings.better_sensor)


def _proposal(seen: TagDerivatives, now: _Known, after: _Known, bench: Instruments) -> Proposal:
    x, y, turned = (seen.tip[-2] - seen.tip[-1]).tolist()
    again = seen.made in bench.pushes
    return Proposal(seen.made, again, math.hypot(x, y), turned, now.quality(), after.quality(), after.sd())


def _left(proposal: Proposal) -> float:
    return proposal.after.mean_width


def _cost_and_left(proposal: Proposal) -> tuple[int, float]:
    cost = 2 if proposal.better_sensor is not None else 1 if proposal.added_tag is not None else 0
    return cost, _left(proposal)


def _distinct(ranked: list[Proposal], settings: PlanSettings) -> tuple[Proposal, ...]:
    kept: list[Proposal] = []
    for one in ranked:
        alike = [k for k in kept if _kind(k) == _kind(one)]
        if all(abs(k.push.at_s - one.push.at_s) >= settings.apart for k in alike):
            kept.append(one)
    best = {_kind(one): i for i, one in reversed(list(enumerate(kept)))}
    others = [i for i in range(len(kept)) if i not in best.values()]
    told = [*sorted(best.values()), *others][: settings.count]
    return tuple(kept[i] for i in sorted(told))


def _kind(one: Proposal) -> str:
    if one.added_tag is not None:
        return "tag"
    if one.better_sensor is not None:
        return "sensor"
    return "again" if one.repeats else "new"


def _updated(covariance: Array, told: Array) -> Array:
    """`(C^-1 + H)^-1` without an inverse of C."""
    out = np.linalg.solve(np.eye(len(covariance)) + covariance @ told, covariance)
    return np.asarray(0.5 * (out + out.T))


def _left_out(found: list[LargestPush]) -> tuple[str, ...]:
    out = []
    for why in dict.fromkeys(r.why_not for r in found if r.why_not):
        these = [r for r in found if r.why_not == why]
        where = sorted({r.at_s for r in these})
        turned = sorted({round(float(np.rad2deg(r.direction))) for r in these})
        span = f"{where[0]:.2g}" if len(where) == 1 else f"{where[0]:.2g} to {where[-1]:.2g}"
        count = f"{len(these)} pushes" if len(these) > 1 else "1 push"
        out.append(f"{count} at s = {span} in directions {turned} deg left out: {why}.")
    return tuple(out)
