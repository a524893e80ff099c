"""Allowances: groups of parameters with priors, for effects of a real beam and bench that the ideal beam lacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Literal

import numpy as np

from onebend.beam.grid import Grid, Modes, apply
from onebend.beam.problem import Problem, riding_beyond
from onebend.beam.sensitivity import of_mass
from onebend.beam.setup import MOST_REACHED, posture_terms
from onebend.beam.stiffness import Profile, RectangularSection, Uniform
from onebend.errors import LearningError
from onebend.learning.frames import push_places
from onebend.recording.plane import HEIGHT_SD, camera_place
from onebend.recording.signals import bridged
from onebend.records import END_ID, Array, BoolArray, Observations, PointMass, View, left_of, tags_among, unit

# Where an allowance enters the model, and what its `basis` is there. F frames, Q nodes, m tags, n parameters:
#   "log k"       (Q, n) or (F, Q, n): added to log k at the nodes
#   "force"       (F, 2, n): added to the force on the beam, per N
#   "place"       (F, n) 1: added to the place of the push [m]
#   "load"        (F, Q, 2, n): added to the force beyond each node [N]
#   "clamp"       (F, n) 1: added to the clamp's angle [rad]
#   "poses"       (F, m, 3, n): added to the tags' poses
#   "section", "relaxation", "length", "bench": the model's own; no basis, or the frames' times
Entry = Literal["log k", "force", "place", "load", "clamp", "poses", "section", "relaxation", "length", "bench"]


ANYTHING, POSITIVE = (-np.inf, np.inf), (0.0, np.inf)
# `Allowance.sizes` of an effect that most benches lack: each factor of two is as probable as any other.
RARE = tuple(np.geomspace(0.005, 2.0, 17).tolist())
# The same of an error with a stated tolerance: many benches are better than what is stated. Below a tenth of it, the
# error changes nothing that is learned.
TOLERATED = tuple(np.geomspace(0.1, 1.6, 5).tolist())


def _nothing() -> Array:
    return np.zeros(0)


@dataclass(frozen=True)
class Allowance:
    """n parameters, zero for the ideal beam on the ideal bench, with one sd each before the data."""

    name: str
    enters: Entry
    unit: str
    labels: tuple[str, ...]  # (n,)
    prior_sd: Array  # (n,)
    basis: Array = field(default_factory=_nothing)  # see `Entry`
    shared: bool = False  # by all recordings of the beam; else each recording has its own
    sized: bool = False  # the evidence chooses one factor on all of `prior_sd`
    within: tuple[float, float] = ANYTHING  # bounds of each parameter
    sizes: tuple[float, ...] = (1.0,)  # over `prior_sd`; several, equally probable: its size is unknown, see `sites`
    together: bool = False  # one size for all n, else each has its own
    powers: Array = field(default_factory=_nothing)  # (n,) of the displacement in its functions; empty: none
    of_force: bool = False  # `prior_sd` goes with the largest force

    @property
    def count(self) -> int:
        return len(self.labels)


LEFT = "remaining discrepancy"
Sizes = Mapping[str, float]  # factors on the `prior_sd` of the allowances that are `sized`, by their names


@dataclass(frozen=True)
class Film:
    """What of a whole recording only the fit knows; F frames, those at rest last."""

    observations: Observations
    frames: BoolArray  # which of the recording are used
    measured: Array  # (F, m, 3) poses
    problem: Problem
    gravity: Array  # (F, 2) m/s^2
    line: Profile  # kg/m, mass as written
    rate: Array  # (F, 2) N/s, derivative of the logged force


@dataclass(frozen=True)
class PushCourse:
    """F frames of one push in order of time, then the beam at rest, where all is zero."""

    length: float  # m
    marker_s: Array  # (m,)
    on_body: BoolArray  # (m,) which of them are tags; the others are points of an outline
    across: Array  # (F, m, 2) unit vectors across the outline at its points; zeros at tags and at the body's end
    tags: tuple[str, ...]  # their names
    tag_size: float  # m, NaN if unknown
    thick: bool  # the section's thickness is known
    friction_sd: float  # prior sd of the tool's coefficient of friction
    time: Array  # (T,) s, without those at rest
    force: Array  # (F, 2) N
    largest: float  # N, the largest force
    push_s: Array  # (F,)
    bend: Array  # (F,) displacement of the tags, over its largest
    back: Array  # (F,) 1 after the largest displacement
    elapsed: Array  # (F,) 0 to 1: integral of `bend` over time so far, over its end
    turn: Array  # (F, m) rad of each tag since rest
    moved: Array  # (F, 2) displacement of the beam since rest where it is pushed, over the length
    film: Film | None = None  # None: the frames so far, as they come; `bend` is then over the length

    @property
    def pushed(self) -> bool:
        """Whether a force acts, or may act in the frames to come."""
        return self.film is None or bool(np.any(self.force))

    @property
    def turn_at_push(self) -> Array:
        """(F,) rad since rest of the beam where it is pushed."""
        return at_places(self.push_s, self.marker_s, self.turn[..., None])[:, 0]


def course_of(
    observations: Observations, frames: BoolArray, film: Film | None = None, across: Array | None = None
) -> PushCourse:
    """Of the chosen `frames` (T,) of a recording; with a `film`, the frames at rest that it has behind them. `across`
    as of `PushCourse`; without it an outline has no errors of its own."""
    o, on_body = observations, tags_among(observations)
    time, xy, angle, force = o.time[frames], o.xy[frames], o.angle[frames], o.force[frames]
    rest = np.where(np.isfinite(o.rest_xy), o.rest_xy, xy[0])
    at_rest = np.where(np.isfinite(o.rest_angle), o.rest_angle, 0.0)
    displacement, turn = filled(xy - rest), filled((angle - at_rest)[..., None])[..., 0]
    away = np.sqrt(np.mean(np.sum(displacement**2, axis=-1), axis=1))
    largest = max(float(np.max(away)), np.finfo(float).tiny)
    bend = away / largest
    step = np.gradient(time) if len(time) > 1 else np.ones(1)
    elapsed = np.cumsum(bend * step)
    elapsed = elapsed / max(float(elapsed[-1]), np.finfo(float).tiny)
    back = np.asarray(np.arange(len(time)) > int(np.argmax(bend)), dtype=float)
    count = len(time) if film is None else len(film.measured)
    push_s = push_places(o)[frames]
    return PushCourse(
        length=o.length,
        marker_s=o.marker_s,
        on_body=on_body,
        across=np.zeros((count, len(on_body), 2)) if across is None else across * (o.tag_id != END_ID)[:, None],
        tags=tuple(f"tag {i}" for i in o.tag_id[on_body]),
        tag_size=o.stated.tag_size,
        thick=bool(np.isfinite(o.stated.thickness)),
        friction_sd=o.stated.friction_sd,
        time=time,
        force=with_rest(force, count),
        largest=float(np.max(np.linalg.norm(force, axis=1), initial=0.0)),
        push_s=with_rest(push_s, count),
        bend=with_rest(bend, count),
        back=with_rest(back, count),
        elapsed=with_rest(elapsed, count),
        turn=with_rest(turn, count),
        moved=with_rest(at_places(push_s, o.marker_s, displacement) / o.length, count),
        film=film,
    )


_LITTLE = 0.01  # of the sum of the squares of all motion: of less in common, a proportion is noise


def filled(moved: Array) -> Array:
    """(T, m, n) of what m markers have moved since rest (T, m, n). Where one was not seen (NaN), it has moved in
    proportion to the nearest one that was, by the frames that show both; as much where these show no motion."""
    out, count = moved.copy(), moved.shape[1]
    for i in np.flatnonzero(~np.isfinite(moved).all(axis=(0, 2))):
        for j in sorted(set(range(count)) - {int(i)}, key=lambda j: abs(j - i)):
            one, other = moved[:, i], moved[:, j]
            both = np.where(np.isfinite(one * other), other, 0.0)
            little = _LITTLE * np.nansum(other**2, axis=0) + _SMALL
            share = (np.sum(np.nan_to_num(one) * both, axis=0) + little) / (np.sum(both**2, axis=0) + little)
            out[:, i] = np.where(np.isfinite(out[:, i]), out[:, i], share * other)
    return np.nan_to_num(out)


def at_places(places: Array, marker_s: Array, moved: Array) -> Array:
    """(T, n) at places (T,), between the clamp and markers that moved by (T, m, n)."""
    known, from_clamp = np.append(0.0, marker_s), np.pad(moved, ((0, 0), (1, 0), (0, 0)))
    return np.array([[np.interp(s, known, c) for c in one.T] for s, one in zip(places, from_clamp, strict=True)])


def with_rest(values: Array, count: int) -> Array:
    """(count, ...) values (T, ...) of the frames; zero in the frames behind, which show the beam at rest."""
    out = np.zeros((count, *values.shape[1:]))
    out[: len(values)] = values
    return out


CLAMP_TAG = 1.0 / 3.0  # s about which a point of an outline is taken for the tag next to the clamp
GIVE_SD = 0.01  # rad per rad that the first tag turns


def giving(course: PushCourse) -> Allowance:
    """The moment at the clamp follows the turn of the tag beside it."""
    beside = 0 if course.on_body.all() else int(np.argmin(np.abs(course.marker_s - CLAMP_TAG)))
    sd, basis = np.array([GIVE_SD]), course.turn[:, beside, None]
    return Allowance("clamp gives", "clamp", "1", ("clamp gives",), sd, basis, within=POSITIVE, sizes=RARE)


SLIDE_SD = 2.5e-3  # m per rad that the beam turns at the push: the radius of a finger or a rod


def sliding(course: PushCourse) -> Allowance | None:
    """`s_a(t) = s_0 + b (a(s_0, t) - a(s_0, 0))` with b in m per rad."""
    if not course.pushed:
        return None
    sd, basis = np.array([SLIDE_SD]), course.turn_at_push[:, None]
    return Allowance("slide", "place", "m/rad", ("contact slides",), sd, basis, sizes=RARE)


def rubbing(course: PushCourse) -> Allowance | None:
    """A force along the beam that the log does not contain, in proportion to the logged one across it (Coulomb's
    friction), of one sign in a push. A sensor of two axes measures friction, so it is allowed for only where stated."""
    if not course.pushed or course.friction_sd == 0.0:
        return None
    turn = course.turn_at_push
    along = unit(turn)
    across = course.force[:, 1] * along[:, 0] - course.force[:, 0] * along[:, 1]
    sd, basis = np.array([course.friction_sd]), (across[:, None] * along)[..., None]
    return Allowance("rub", "force", "1", ("friction of the tool",), sd, basis, sizes=RARE)


LAG_SD = 0.05  # s^2, half of the square of a lag of 0.3 s


def slow_sensor(film: Film) -> Allowance | None:
    """What a sensor's lag t leaves where the clocks' offset takes up the delay: a first-order filter writes L with the
    force `F = L + t L'`, which is `L(time + t) - t^2/2 L''(time + t)` to second order. The parameter is t^2/2."""
    count = int(np.sum(film.frames))
    if count < 2 or not np.any(film.rate):
        return None
    bent = with_rest(np.gradient(film.rate[:count], film.observations.time[film.frames], axis=0), len(film.rate))
    label, sd = ("half of the sensor's lag squared",), np.array([LAG_SD])
    return Allowance("lag", "force", "s^2", label, sd, -bent[..., None], within=POSITIVE, sizes=RARE)


LOOP_SD = 0.05  # of the force
_TURNS = 0.1  # of the fastest motion: where the beam moves more slowly, one branch goes over into the other


def hysteresis(course: PushCourse) -> Allowance | None:
    """The log's scale is another one where the beam is bent than where it is let go: sensor or beam lose energy however
    slowly they move. Half of the difference."""
    count = len(course.time)
    if not course.pushed or count < 2:
        return None
    speed = with_rest(np.gradient(course.bend[:count], course.time), len(course.force))
    out = speed / np.hypot(speed, max(_TURNS * float(np.max(np.abs(speed))), _SMALL))
    basis = (out[:, None] * course.force)[..., None]
    return Allowance("hysteresis", "force", "1", ("hysteresis of the force",), np.array([LOOP_SD]), basis, sizes=RARE)


# Discrepancy between model and world (Kennedy and O'Hagan 2001): every coordinate of every tag may be off by a function
# that is smooth in the bending and in time. The evidence chooses its size.

PLACE_SD = 5e-5  # m, of each function's coefficient, before the evidence has chosen
LEVER = 0.3  # of the length: a smooth error of place d has a slope of about d over this


_FIVE = np.array([1.0, 2.0, 1.0, 2.0, 0.0])  # powers of the displacement in the smooth functions
_LINEAR = [0, 2]  # those of frames as they come, for time's sake: on both ways
# Their sd is such that at the largest displacement they are worth as much as all five.
_WORTH = float(np.sqrt((1.0 + 1.0 + 0.25 + 0.25 + 1.0) / (1.0 + 0.25)))


def discrepancy(course: PushCourse) -> Allowance | None:
    """Of the tags' places."""
    return _discrepancy(course, "discrepancy", "m", {"x": 0, "y": 1}, PLACE_SD)


def angle_discrepancy(course: PushCourse) -> Allowance | None:
    """Of the tags' angles."""
    return _discrepancy(course, "angle discrepancy", "rad", {"angle": 2}, PLACE_SD / (LEVER * course.length))


def _discrepancy(course: PushCourse, name: str, unit: str, axes: Mapping[str, int], sd: float) -> Allowance | None:
    """The smooth functions for each of these coordinates of each tag."""
    if not course.tags:
        return None
    functions, powers = smooth_functions(course), _FIVE
    if course.film is None:
        functions, powers, sd = functions[:, _LINEAR], _FIVE[_LINEAR], _WORTH * sd
    n, on_body = functions.shape[1], np.flatnonzero(course.on_body)
    labels = tuple(f"discrepancy {t} {a}{i}" for a in axes for t in course.tags for i in range(n))
    basis = np.zeros((len(functions), len(course.on_body), 3, len(axes), len(on_body), n))
    for i, axis in enumerate(axes.values()):
        for number, tag in enumerate(on_body):
            basis[:, tag, axis, i, number] = functions
    sds, powers = np.full(len(labels), sd), np.tile(powers, len(labels) // n)
    return Allowance(name, "poses", unit, labels, sds, basis.reshape(*basis.shape[:3], -1), sized=True, powers=powers)


def smooth_functions(course: PushCourse) -> Array:
    """(F, 5)."""
    bend, side = course.bend, course.back - 0.5
    return np.stack([bend, bend**2, bend * side, bend**2 * side, course.elapsed], axis=1)


OUTLINE_SD = 5e-5  # m, of each function's coefficient, before the evidence has chosen
LIGHT_SD = 2e-4  # m
_TERMS = 6  # Legendre polynomials along the body


def outline_error(course: PushCourse) -> Allowance | None:
    """The error of an outline that grows with the bending, smooth along the body: walls come into sight."""
    across, in_time = course.across, np.column_stack([course.bend, course.bend**2])  # (F, 2)
    if not np.any(across):
        return None
    along = np.polynomial.legendre.legvander(2.0 * course.marker_s - 1.0, _TERMS - 1)  # (m, n)
    basis = np.zeros((*across.shape[:2], 3, 2 * _TERMS))
    basis[:, :, :2] = np.einsum("fmc,ft,mn->fmctn", across, in_time, along).reshape(*across.shape, -1)
    labels = tuple(f"outline error {t}{n}" for t in ("grows", "grows more") for n in range(_TERMS))
    sd, powers = np.full(len(labels), OUTLINE_SD), np.repeat([1.0, 2.0], _TERMS)
    return Allowance("outline", "poses", "m", labels, sd, basis, sized=True, powers=powers)


def light(course: PushCourse) -> Allowance | None:
    """Light from one side, and shadow, move both edges the same way in the picture, however the body is turned."""
    across = course.across
    if not np.any(across):
        return None
    basis = np.zeros((*across.shape[:2], 3, 2))
    basis[:, :, :2] = across[..., :, None] * across[..., None, :]
    return Allowance("light", "poses", "m", ("edges lie off in x", "edges lie off in y"), np.full(2, LIGHT_SD), basis)


_WINDOW, _DEGREE = 7, 3  # frames and degree of the polynomial whose curvature is the acceleration
MASS_SD = 25.0  # kg/m^3, of the length cubed: a solid rubber beam, 0.08 by 0.2 of its length thick and wide, has 18


def unknown_mass(course: PushCourse) -> Allowance | None:
    """The unknown mass [kg] of a moving beam, evenly spread; None where it is stated or no acceleration is known."""
    film = course.film
    if film is None or np.isfinite(film.observations.stated.mass):
        return None
    count, even = len(course.force), Uniform(1.0 / course.length)
    force = inertial_force(film.observations, film.frames, film.problem, even, count)
    if not np.any(force):
        return None
    sd = np.array([MASS_SD * course.length**3])
    return Allowance("inertia", "load", "kg", ("mass in motion",), sd, force[..., None], shared=True, within=POSITIVE)


def gravity_direction(course: PushCourse) -> Allowance | None:
    """Gravity turned by one angle [rad]; None if exact, or without weight."""
    film = course.film
    if film is None or not film.observations.stated.gravity_sd > 0.0 or not np.any(film.gravity):
        return None
    nodes, stated, gravity = film.problem.grid.nodes, film.observations.stated, film.gravity
    beyond = weight_beyond(film.problem, np.asarray(film.line(nodes))[..., None], gravity)[..., 0]
    beyond = beyond + riding_beyond(nodes, stated.masses)[..., None] * gravity[:, None, :]
    sd, turned = np.array([stated.gravity_sd]), left_of(beyond)[..., None]
    return Allowance("gravity direction", "load", "rad", ("gravity's direction",), sd, turned)


def weight_beyond(problem: Problem, line: Array, gravity: Array) -> Array:
    """(F, Q, 2, n) N beyond each node, of n masses per length `line` (Q, n) or (F, Q, n) [kg/m]."""
    force = of_mass(problem, line, gravity).force
    assert force is not None
    return force


def inertial_force(
    observations: Observations,
    frames: BoolArray,
    problem: Problem,
    mass_per_length: Profile,
    count: int,
    masses: Sequence[PointMass] = (),
) -> Array:
    """(count, Q, 2) N beyond each node: `-L int_s^1 mu a ds`, and -m a of the `masses`; zero at rest or unknown motion.

    The acceleration a is interpolated linearly between clamp and tags, and constant beyond the last tag.
    """
    nodes = problem.grid.nodes
    still = np.zeros((count, nodes.shape[-1], 2))
    acceleration = tag_accelerations(observations)
    if acceleration is None:
        return still
    places = np.append(0.0, observations.marker_s)
    of_tags = np.concatenate([np.zeros((int(np.sum(frames)), 1, 2)), acceleration[frames]], axis=1)
    at_nodes = np.broadcast_to(nodes, (len(still), nodes.shape[-1]))[: len(of_tags)]
    along = np.stack(
        [[np.interp(s, places, a[:, c]) for s, a in zip(at_nodes, of_tags, strict=True)] for c in range(2)], axis=-1
    )
    line = with_rest(-float(problem.length) * along, count) * np.asarray(mass_per_length(nodes))[..., None]
    beyond = [
        np.sum(problem.weights * line[..., c], axis=-1, keepdims=True) - apply(problem.to_nodes, line[..., c])
        for c in range(2)
    ]
    riding = np.zeros_like(still)
    for one in masses:
        there = np.stack([[np.interp(one.s, places, a[:, c]) for a in of_tags] for c in range(2)], axis=-1)
        riding -= with_rest(one.mass * there, count)[:, None, :] * (nodes < one.s)[..., None]
    return np.stack(beyond, axis=-1) + riding


def tag_accelerations(observations: Observations) -> Array | None:
    """(T, m, 2) m/s^2 by polynomials over a few frames, of a tag that is hidden in proportion to its neighbour's; None
    for films that are too short, or of uneven frames."""
    if observations.means is not None:
        return observations.means.acceleration
    time, count = observations.time, len(observations.time)
    if count < 2 * _WINDOW:
        return None
    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    if len(even) > 2 * count:
        return None
    longest = np.where(tags_among(observations), _WINDOW // 2 * step, np.inf)  # an outline is read in few frames
    flat = bridged(time, observations.xy.reshape(count, -1), np.repeat(longest, 2))
    powers = np.vander((np.arange(_WINDOW) - _WINDOW // 2) * step, _DEGREE + 1, increasing=True)
    weights = 2.0 * np.linalg.pinv(powers)[2]  # of the best polynomial, in the middle (Savitzky, Golay)
    evenly = [np.pad(np.interp(even, time, c), _WINDOW // 2, mode="reflect", reflect_type="odd") for c in flat.T]
    back = [np.interp(time, even, np.convolve(c, weights[::-1], "valid")) for c in evenly]
    return filled(np.stack(back, axis=1).reshape(observations.xy.shape))


LENGTH_SD = 0.005  # of the length


def length(course: PushCourse) -> Allowance:  # noqa: ARG001 - as its sisters
    """The log of the length, over what is written: measured anew on every bench, it is exact by chance alone."""
    return Allowance("length", "length", "1", ("log of length",), np.array([LENGTH_SD]), shared=True)


# Each recording has a k(s) of its own around that of the beam, because mounting (clamp, set and temper of the material)
# changes it. With several recordings the evidence chooses how much.

BETWEEN = "between recordings"
BETWEEN_SD = np.array([0.05, 0.03, 0.03])  # of log k: level, slope and bow, before the evidence chooses a factor
_SHAPES = Modes(len(BETWEEN_SD))  # Legendre polynomials over the beam


def between_recordings(nodes: Array) -> Allowance:
    """A recording's own level, slope and bow of log k; `nodes` (Q,) or (F, Q) of the beam's grid."""
    labels = tuple(f"own {what} of log k" for what in ("level", "slope", "bow"))
    return Allowance(BETWEEN, "log k", "1", labels, BETWEEN_SD, _SHAPES.curvature(nodes), sized=True)


# Tags are patches that stiffen the beam by one factor. Their width is known only by how likely each is, so a patch is a
# sum of patches of several widths, none of which softens. At a distance d from a tag's middle log k has the variance
# `PATCH_SD^2` times the probability that the patch reaches d.

PATCH_SD = 0.4  # of the log of the factor on k under a tag: paper to stiff plastic
SHARES = np.array([0.25, 0.5, 0.25])  # of the widths below
WIDTHS = np.array([1.05, 1.25, 1.6])  # of a patch over the tag's black square: a printed tag has a rim of one cell
_GLUED = (0.01, 0.1, 1.0, 2.0)  # `Allowance.sizes` of what is glued on: half of the tags hardly stiffen
USUAL_SIZE = 0.08  # of the length: a tag's black square where nobody says its size
_USUAL_WIDTHS = np.array([0.8, 1.25, 1.9])  # over `USUAL_SIZE`
_SOFT = 0.04  # of half a width: its edge in s
_FINE = 4001  # places


def patch_functions(marker_s: Array, length: float, tag_size: float, s: Array) -> Array:
    """`s.shape + (3,)`: the profiles of patches of each width, 1 under the tags; `tag_size` m, NaN if unknown."""
    known = bool(np.isfinite(tag_size))
    half = 0.5 * (WIDTHS * tag_size / length if known else _USUAL_WIDTHS * USUAL_SIZE)
    away = np.min(np.abs(np.asarray(s)[..., None] - marker_s), axis=-1)[..., None]
    return np.asarray(0.5 - 0.5 * np.tanh((away - half) / (2.0 * _SOFT * half)))


def patch_means(marker_s: Array, length: float, tag_size: float, grid: Grid) -> Array:
    """`grid.nodes.shape + (3,)`: means of `patch_functions` over each node's part of the beam."""
    fine = np.linspace(0.0, 1.0, _FINE)
    values = patch_functions(marker_s, length, tag_size, fine)
    steps = 0.5 * (values[1:] + values[:-1]) / (_FINE - 1)
    integral = np.concatenate([np.zeros((1, len(WIDTHS))), np.cumsum(steps, axis=0)])
    edges = np.cumsum(grid.weights, axis=-1)
    to_edges = np.stack([np.interp(edges, fine, one) for one in integral.T], axis=-1)
    return np.asarray(np.diff(to_edges, axis=-2, prepend=0.0) / grid.weights[..., None])


def patches(course: PushCourse) -> Allowance | None:
    """The logs of the factors on k of patches of each width, the same under all tags, for they are alike; without a
    film no basis."""
    if not course.tags:
        return None
    basis = np.zeros((0, len(WIDTHS)))
    if course.film is not None:
        grid = course.film.problem.grid
        basis = patch_means(course.marker_s[course.on_body], course.length, course.tag_size, grid)
    labels = tuple(f"log k under the tags, {name}" for name in ("narrow", "usual", "wide"))
    sd = PATCH_SD * np.sqrt(SHARES)
    return Allowance("patches", "log k", "1", labels, sd, basis, shared=True, within=POSITIVE, sizes=_GLUED)


# Camera: a point at height z over the tags' plane appears too far from the camera's foot, by `z / D` times its distance
# from there, D being the camera's height. Errors of the plane, of the tags' heights, of focal length and lens move all
# poses of all frames together.

READOUT_SD = 0.015  # s, from the picture's first row to its last
_STEP = 1e-4  # m, to either side of a place, for the slope of a row
_SMALL = np.finfo(float).tiny


def outline_height(observations: Observations, measured: Array) -> Allowance | None:
    """Of an outline [m], at the clamp and at the tip: over the tags beside it, for that of a round body lies below, or
    over the plane of the base. `measured` (F, m, 3) poses. None without an outline in a film."""
    s, tags = observations.marker_s, tags_among(observations)
    view = observations.source.view
    if tags.all() or view is None:
        return None
    basis = _lifted(view, measured, np.column_stack([1.0 - s, s]) * ~tags[:, None])
    labels, sd = ("height of the outline at the clamp", "height of the outline at the tip"), np.full(2, HEIGHT_SD)
    free = Allowance("outline height", "poses", "m", labels, sd, basis, shared=True, sizes=RARE)
    return free if tags.any() else replace(free, sizes=TOLERATED, together=True)


def _lifted(view: View, measured: Array, functions: Array) -> Array:
    """(F, m, 3, n): what heights, by these functions (m, n), do to poses (F, m, 3)."""
    foot, distance = camera_place(view)
    away = np.nan_to_num(measured[..., :2] - foot) / distance
    basis = np.zeros((*measured.shape, functions.shape[1]))
    basis[:, :, :2] = away[..., None] * functions[:, None, :]
    return basis


def camera(observations: Observations, frames: BoolArray, count: int) -> Allowance | None:
    """The unknowns of the camera and of the tags' plane, in sds; `count` frames, those at rest last.

    The frame is fixed to the base tag and to the tags at rest: their turn is subtracted.
    """
    o = observations
    if o.by_camera is None:
        return None
    bare = ~o.loaded & np.all(np.isfinite(o.xy), axis=(1, 2))
    rest = np.where(np.isfinite(o.rest_xy), o.rest_xy, 0.0)
    at_rest = o.by_camera[bare].mean(axis=0) if bare.any() else np.zeros(o.by_camera.shape[1:])
    reach = float(np.sum(rest**2))
    turn = np.sum(rest[:, 0, None] * at_rest[:, 1] - rest[:, 1, None] * at_rest[:, 0], axis=0) / max(reach, _SMALL)
    basis = np.zeros((count, *o.by_camera.shape[1:]))
    basis[: int(frames.sum())] = _less_turn(o.by_camera[frames], np.nan_to_num(o.xy[frames]), turn)
    basis[int(frames.sum()) :] = _less_turn(at_rest, rest, turn)
    n = basis.shape[-1]
    return Allowance("camera", "poses", "1", tuple(f"camera and plane {i}" for i in range(1, n + 1)), np.ones(n), basis)


def _less_turn(moved: Array, xy: Array, turn: Array) -> Array:
    """(..., m, 3, n) what poses at (..., m, 2) m move by, in a frame that turns by `turn` (n,) rad."""
    turned = np.stack([-xy[..., 1], xy[..., 0], np.ones(xy.shape[:-1])], axis=-1)
    return np.asarray(moved - turned[..., None] * turn)


def rolling_shutter(observations: Observations, frames: BoolArray, count: int) -> Allowance | None:
    """The read-out time [s] of a picture, first row to last: rows, and the corners of a tag, are seen at different
    instants, so moving tags are shifted and turned (half the curl). The principal point is assumed in the middle;
    `count` frames, those at rest last."""
    o, view = observations, observations.source.view
    if view is None or not view.matrix[1, 2] > 0.0:  # the picture's rows are not known
        return None
    pose = np.concatenate([o.xy, o.angle[..., None]], axis=-1)
    moved = filled(pose - np.nan_to_num(np.concatenate([o.rest_xy, o.rest_angle[:, None]], axis=-1)))
    speed = np.gradient(moved, o.time, axis=0) if len(o.time) > 1 else np.zeros_like(pose)
    xy, late = np.nan_to_num(o.xy), _row(view)
    shift = speed * late(xy)[..., None]
    by_x, by_y = (late(xy + step) - late(xy - step) for step in _STEP * np.eye(2))
    shift[..., 2] += (speed[..., 1] * by_x - speed[..., 0] * by_y) / (4.0 * _STEP)
    basis = with_rest(shift[frames][..., None], count)
    return Allowance("rolling shutter", "poses", "s", ("read-out time",), np.array([READOUT_SD]), basis)


def _row(view: View) -> Callable[[Array], Array]:
    """Of points (..., 2) m in the plane: the row (...) where they are seen, from the middle one, of all rows."""

    def row(p: Array) -> Array:
        seen = p @ view.rotation[:, :2].T + view.translation
        return np.asarray(view.matrix[1, 1] * seen[..., 1] / seen[..., 2] / (2.0 * view.matrix[1, 2]))

    return row


POSTURE_SD = 0.02  # of the largest force, each axis at the largest displacement; of the linear part no size is told


def posture_sd(course: PushCourse) -> float:
    """N, of each coefficient of `posture_terms` in a push of this size."""
    reach = float(np.max(np.linalg.norm(posture_terms(course.moved), axis=1)))
    return POSTURE_SD * course.largest / max(reach, _SMALL)


def posture_bias(course: PushCourse) -> Allowance | None:
    """A polynomial of second degree in the displacement of the pushed place, zero at rest, for each axis of the force
    [N]; of frames as they come one in the displacement of the tags."""
    if not course.pushed:
        return None
    bend = course.bend
    live = course.film is None
    terms = np.stack([bend, bend**2], axis=1) if live else posture_terms(course.moved)
    n = terms.shape[1]
    labels = tuple(f"posture bias {axis}{i}" for axis in "xy" for i in range(1, n + 1))
    sd = np.full(2 * n, POSTURE_SD * course.largest / np.sqrt(n) if live else posture_sd(course))
    basis = np.zeros((len(terms), 2, 2, n))
    basis[:, [0, 1], [0, 1]] = terms[:, None, :]
    powers = np.tile([1.0, 2.0], 2) if live else _nothing()
    basis = basis.reshape(len(terms), 2, 2 * n)
    return Allowance(
        "posture", "force", "N", labels, sd, basis, sizes=RARE, together=not live, powers=powers, of_force=True
    )


# The material relaxes (generalised Maxwell solid): `M = k_i (q - sum a_j v_j)` with `tau_j v_j' = q - v_j`, fixed times
# tau_j and shares a_j. A static model learned from a push finds the secant modulus `k = k_i (1 - c)`; c is the mean
# part of the curvature that `v = sum a_j v_j` has reached, weighted by its square. The fit's k(s) is the secant one.

TIMES = np.array([1.0, 3.0, 9.0])  # s, tau_j
SHARE_SD = 0.05  # of each a_j: shares of the stiffness that relax


def relaxation(course: PushCourse) -> Allowance:
    """The shares that relax with each of the times."""
    labels, sd = tuple(f"share that relaxes within {t:g} s" for t in TIMES), np.full(len(TIMES), SHARE_SD)
    return Allowance("relaxation", "relaxation", "1", labels, sd, course.time, shared=True, within=POSITIVE, sizes=RARE)


def lags(time: Array) -> Array:
    """(n, T, T) maps of values, linear in `time` (T,) [s] and before it as at first, to their lagged ones, one a time;
    cached, read only."""
    return _lags(np.asarray(time, dtype=float).tobytes())


@lru_cache(maxsize=4)
def _lags(instants: bytes) -> Array:
    time = np.frombuffer(instants)
    kept, before, now = lag_weights(np.diff(time))
    out = np.zeros((len(TIMES), len(time), len(time)))
    out[:, 0, 0] = 1.0  # weight has bent the beam, or a push held it, for long
    for i in range(len(time) - 1):
        out[:, i + 1] = kept[:, i, None] * out[:, i]
        out[:, i + 1, i] += before[:, i]
        out[:, i + 1, i + 1] += now[:, i]
    out.flags.writeable = False
    return out


def lag_weights(seconds: Array) -> tuple[Array, Array, Array]:
    """(n, N) each, of steps of `seconds` (N,): weights of v_j before a step, of q before it and of q at its end."""
    step = np.maximum(seconds / TIMES[:, None], np.finfo(float).tiny)  # frames of one instant are one
    decay = np.exp(-step)
    mean = -np.expm1(-step) / step
    return decay, mean - decay, 1.0 - mean


def memory(shares: Array, time: Array) -> Array:
    """(T, T): v of curvatures q (T, Q) is `memory @ q`."""
    return np.tensordot(shares, lags(time), 1)


def rest_shift(remembering: Array, q: Array, weights: Array) -> Array:
    """(F, Q) rad by which relaxation shifts the curvature at rest, the stiffness being the secant one.

    `remembering` (T, T) is the `memory` of the first T frames; `q` (F, Q) the curvature over the one at rest, F - T
    frames at rest behind. From `k_i (q - v) = k (q - (v - c q) / (1 - c))`.
    """
    count, out = len(remembering), np.zeros_like(q)
    v = remembering @ q[:count]
    reached = reached_part(v, q[:count], weights)
    out[:count] = (v - reached * q[:count]) / (1.0 - min(reached, MOST_REACHED))
    return out


def reached_part(v: Array, q: Array, weights: Array) -> float:
    """c: the part of the curvature q (T, Q) that v (T, Q) has reached, over all of the push."""
    square = float(np.sum(weights * q**2))
    return float(np.sum(weights * q * v)) / square if square > 0.0 else 0.0


def secant_share(remembering: Array, q: Array, weights: Array) -> float:
    """`1 - c`: the secant stiffness over the instantaneous one."""
    count = len(remembering)
    return 1.0 - reached_part(remembering @ q[:count], q[:count], weights)


def remembered(remembering: Array, q: Array, weights: Array, change: Array) -> Array:
    """(F, Q, P) by which the curvature at rest shifts with changes (F, Q, P) of the curvature, to first order."""
    count, p = len(remembering), change.shape[-1]
    bent, moved = q[:count], change[:count].reshape(count, -1)
    v, square = remembering @ bent, float(np.sum(weights * bent**2))
    reached = reached_part(v, bent, weights)
    left = 1.0 - min(reached, MOST_REACHED)
    by_shape = weights * (v - 2.0 * reached * bent) + remembering.T @ (weights * bent)
    reached_moved = by_shape.ravel() @ moved.reshape(-1, p) / max(square, np.finfo(float).tiny)  # (P,)
    by_reached = (v - reached * bent) / left**2 - bent / left
    out = ((remembering - reached * np.eye(count)) / left @ moved).reshape(*bent.shape, p)
    out += by_reached[..., None] * reached_moved
    return with_rest(out, len(q))


def shift_derivatives(shares: Array, time: Array, q: Array, weights: Array) -> Array:
    """(F, Q, n) of `rest_shift` with the shares, q staying as it is."""
    every = lags(time) @ q[: len(time)]  # (n, T, Q)
    bent, out = q[: len(time)], np.zeros((*q.shape, len(shares)))
    reached = np.array([reached_part(one, bent, weights) for one in every])
    _, out[: len(time)] = shift_of_lags(shares, np.moveaxis(every, 0, -1), bent, reached)
    return out


def shift_of_lags(shares: Array, every: Array, q: Array, reached: Array) -> tuple[Array, Array]:
    """(F, Q) and (F, Q, n): what `rest_shift` returns, and its derivatives with the shares (n,).

    `every` (F, Q, n) the curvatures v_j that lag behind q (F, Q), `reached` (n,) the part of q that each has reached.
    """
    all_reached = min(float(shares @ reached), MOST_REACHED)
    away = every @ shares - all_reached * q
    direct = (every - q[..., None] * reached) / (1.0 - all_reached)
    by_shares = direct + away[..., None] * (reached / (1.0 - all_reached) ** 2)
    return away / (1.0 - all_reached), by_shares


@dataclass(frozen=True)
class MaterialMemory:
    """What a beam remembers in F frames of others before them: the curvatures that lag behind are `before + now q`, q
    being the curvature over that at rest; for each of the n `TIMES`."""

    before: Array  # (F, Q, n) rad
    now: Array  # (F, n)
    reached: Array  # (n,) parts of q that they are taken to reach

    def lags(self, q: Array) -> Array:
        """(F, Q, n) rad, of shapes bent by q (F, Q)."""
        return self.before + self.now[:, None, :] * q[..., None]

    def shift(self, shares: Array, q: Array) -> tuple[Array, Array]:
        """See `shift_of_lags`."""
        return shift_of_lags(shares, self.lags(q), q, self.reached)


# Stretch and shear: 1/EA and 1/kGA follow from k(s) and the section's thickness squared. That square is the parameter,
# so its effect on the tags is linear.

USUAL_THICKNESS = 0.08  # of the length, in the direction of bending
NO_THICKNESS = -1.0  # of the relative change of its square: a beam that neither stretches nor shears
UNKNOWN_SD, KNOWN_SD = 1.2, 0.2  # of the square of the thickness, over the usual or the stated one
_NEAR_NONE = 1e-9  # of it: as good as none, where nothing may be divided by


def section(course: PushCourse) -> Allowance:
    """The relative change of the square of the thickness, from the stated one or the usual one."""
    label, sd = "change of section thickness squared", np.array([KNOWN_SD if course.thick else UNKNOWN_SD])
    return Allowance("section", "section", "1", (label,), sd, shared=True, within=(NO_THICKNESS, np.inf))


def section_at(change: float, stated: float, beam_length: float) -> tuple[RectangularSection, float]:
    """The section for stretch and shear, and half the derivative of the log of its compliance with the parameter.

    `stated` m, NaN if unknown. Negative compliances are allowed, so that noise is symmetric about zero.
    """
    usual, share = stated if np.isfinite(stated) else USUAL_THICKNESS * beam_length, 1.0 + change
    if abs(share) < _NEAR_NONE:
        share = _NEAR_NONE
    return RectangularSection(usual, share=share), 0.5 / share


def _of_film(of: Callable[[Film], Allowance | None]) -> Callable[[PushCourse], Allowance | None]:
    """An allowance of the film of a course."""
    return lambda course: None if course.film is None else of(course.film)


@dataclass(frozen=True)
class Effect:
    """What a real beam or bench may do: an entry of the list that the fit, the live learner and the reports read."""

    cause: str  # its name in the reports; several may share one
    allowance: Callable[[PushCourse], Allowance | None]  # None where the course cannot show it
    live: bool = True  # it needs no later frame, no place of the camera, and no prior with mass near nothing


EFFECTS: Mapping[str, Effect] = MappingProxyType(
    {
        "section": Effect("stretch and shear", section),
        "relaxation": Effect("relaxation", relaxation),
        "length": Effect("length", length),
        "clamp gives": Effect("clamp that gives", giving),
        "patches": Effect("stiff tags", patches),
        "discrepancy": Effect(LEFT, discrepancy),
        "angle discrepancy": Effect(LEFT, angle_discrepancy),
        "outline": Effect("outline", outline_error),
        "light": Effect("outline", light),
        "slide": Effect("sliding contact", sliding),
        "rub": Effect("friction of the tool", rubbing, live=False),
        "posture": Effect("posture-dependent bias", posture_bias),
        "lag": Effect("slow sensor", _of_film(slow_sensor), live=False),
        "hysteresis": Effect("hysteresis", hysteresis, live=False),
        "outline height": Effect("outline", _of_film(lambda f: outline_height(f.observations, f.measured)), live=False),
        "rolling shutter": Effect(
            "camera", _of_film(lambda f: rolling_shutter(f.observations, f.frames, len(f.measured))), live=False
        ),
        "camera": Effect("camera", _of_film(lambda f: camera(f.observations, f.frames, len(f.measured))), live=False),
        "inertia": Effect("inertia", unknown_mass, live=False),
        "gravity direction": Effect("direction of gravity", gravity_direction, live=False),
    }
)
OF_ONE = frozenset(EFFECTS)  # those that one recording may have
EVERY_ALLOWANCE = OF_ONE | {BETWEEN}
LIVE_ALLOWANCES = frozenset(name for name, effect in EFFECTS.items() if effect.live)


def allowances_of(course: PushCourse, wanted: frozenset[str]) -> tuple[Allowance, ...]:
    """The wanted allowances that the course can show.

    Raises:
        LearningError: a name that is in no list.
    """
    unknown = sorted(wanted - EVERY_ALLOWANCE)
    if unknown:
        raise LearningError(f"there is no allowance {unknown[0]!r}, only: {', '.join(sorted(EVERY_ALLOWANCE))}")
    every = (effect.allowance(course) for name, effect in EFFECTS.items() if name in wanted)
    return tuple(one for one in every if one is not None)
