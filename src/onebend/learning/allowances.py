"""Allowances: groups of parameters with priors, for effects of a real beam and bench that the ideal beam lacks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from onebend.beam.grid import Grid, Modes, apply
from onebend.beam.problem import Problem
from onebend.beam.stiffness import Profile, RectangularSection, Uniform
from onebend.recording.camera import camera_place
from onebend.records import Array, BoolArray, Observations, PointMass, View, tags_among

# Where an allowance enters the model, and what its `basis` is there. F frames, Q nodes, m tags, n parameters:
#   "log k"       (Q, n) or (F, Q, n): added to log k at the nodes
#   "force"       (F, 2, n): added to the force on the beam, per N
#   "place"       (F, n) 1: added to the place of the push [m]
#   "load"        (F, Q, 2, n): added to the force beyond each node [N]
#   "clamp"       (F, n) 1: added to the clamp's angle [rad]
#   "poses"       (F, m, 3, n): added to the tags' poses
#   "section", "relaxation", "length": the model's own; no basis, or the frames' times
Entry = Literal["log k", "force", "place", "load", "clamp", "poses", "section", "relaxation", "length"]


ANYTHING, POSITIVE = (-np.inf, np.inf), (0.0, np.inf)


@dataclass(frozen=True)
class Allowance:
    """n parameters, zero for the ideal beam on the ideal bench, with one sd each before the data."""

    name: str
    enters: Entry
    unit: str
    labels: tuple[str, ...]  # (n,)
    prior_sd: Array  # (n,)
    basis: Array  # see `Entry`
    shared: bool = False  # by all recordings of the beam; else each recording has its own
    sized: bool = False  # the evidence chooses one factor on all of `prior_sd`
    within: tuple[float, float] = ANYTHING  # bounds of each parameter
    sparse: bool = False  # an effect that most benches lack, see `sites`

    @property
    def count(self) -> int:
        return len(self.labels)


Sizes = Mapping[str, float]  # factors on the `prior_sd` of the allowances that are `sized`, by their names


@dataclass(frozen=True)
class PushCourse:
    """T frames of one recording, in order of time."""

    time: Array  # (T,) s
    bend: Array  # (T,) 0 to 1: displacement of the tags over its largest
    back: Array  # (T,) 1 after the largest displacement
    elapsed: Array  # (T,) 0 to 1: integral of `bend` over time so far, over its end
    turn: Array  # (T, m) rad of each tag since rest; 0 where it was not seen
    largest: float  # m, the largest displacement of the tags, root mean square


def course(observations: Observations, frames: BoolArray) -> PushCourse:
    """Of the chosen `frames` (T,) of a recording."""
    o = observations
    time, xy, angle = o.time[frames], o.xy[frames], o.angle[frames]
    rest = np.where(np.isfinite(o.rest_xy), o.rest_xy, xy[0])
    squares = np.sum((xy - rest) ** 2, axis=-1)
    seen = np.isfinite(squares)
    total = np.sum(np.where(seen, squares, 0.0), axis=1)
    away = np.sqrt(total / np.maximum(np.sum(seen, axis=1), 1))
    largest = max(float(np.max(away)), np.finfo(float).tiny)
    bend = away / largest
    step = np.gradient(time) if len(time) > 1 else np.ones(1)
    elapsed = np.cumsum(bend * step)
    elapsed = elapsed / max(float(elapsed[-1]), np.finfo(float).tiny)
    back = np.asarray(np.arange(len(time)) > int(np.argmax(bend)), dtype=float)
    turn = angle - np.where(np.isfinite(o.rest_angle), o.rest_angle, 0.0)
    return PushCourse(time, bend, back, elapsed, np.where(np.isfinite(turn), turn, 0.0), largest)


def with_rest(values: Array, count: int) -> Array:
    """(count, ...) values (T, ...) of the frames; zero in the frames behind, which show the beam at rest."""
    out = np.zeros((count, *values.shape[1:]))
    out[: len(values)] = values
    return out


CLAMP_TAG = 1.0 / 3.0  # s about which a point of an outline is taken for the tag next to the clamp
GIVE_SD = 0.01  # rad per rad that the first tag turns


def giving(run: PushCourse, count: int, beside: int = 0) -> Allowance:
    """The moment at the clamp follows the turn of the tag `beside` it; `count` frames, those at rest last."""
    basis = with_rest(run.turn[:, beside, None], count)
    return Allowance(
        "clamp gives", "clamp", "1", ("clamp gives",), np.array([GIVE_SD]), basis, within=POSITIVE, sparse=True
    )


SLIDE_SD = 2.5e-3  # m per rad that the beam turns at the push: the radius of a finger or a rod


def sliding(marker_s: Array, run: PushCourse, push_s: Array) -> Allowance:
    """`s_a(t) = s_0 + b (a(s_0, t) - a(s_0, 0))` with b in m per rad; `push_s` (F,)."""
    basis = with_rest(turn_at_push(marker_s, run.turn, push_s)[:, None], len(push_s))
    return Allowance("slide", "place", "m/rad", ("contact slides",), np.array([SLIDE_SD]), basis, sparse=True)


def turn_at_push(marker_s: Array, turn: Array, push_s: Array) -> Array:
    """(T,) rad since rest of the beam at `push_s`, of which there are at least T; `turn` (T, m) of the tags."""
    places = np.append(0.0, marker_s)
    turns = np.concatenate([np.zeros((len(turn), 1)), turn], axis=1)
    return np.array([float(np.interp(s, places, turn)) for s, turn in zip(push_s, turns, strict=False)])


# Discrepancy between model and world (Kennedy and O'Hagan 2001): every coordinate of every tag may be off by a function
# that is smooth in the bending and in time. The evidence chooses its size.

PLACE_SD = 5e-5  # m, of each function's coefficient, before the evidence has chosen
XY, ANGLE = (0, 1), (2,)  # coordinates of a pose
LEVER = 0.3  # of the length: a smooth error of place d has a slope of about d over this


def discrepancy(run: PushCourse, tags: tuple[str, ...], length: float, count: int) -> tuple[Allowance, Allowance]:
    """For the tags' places, and for their angles; `count` frames, those at rest last."""
    return discrepancy_of(with_rest(smooth_functions(run), count), tags, length)


OUTLINE_SD = 5e-5  # m, of each function's coefficient, before the evidence has chosen
_TERMS = 6  # Legendre polynomials along the body


def outline_error(marker_s: Array, run: PushCourse, across: Array) -> Allowance:
    """The error of an outline, smooth along the body: one that stays, and two that grow with the bending (light and
    shade turn with the body, walls come into sight); `across` (F, m, 2), zero at tags, frames at rest last."""
    grows = with_rest(np.stack([run.bend, run.bend**2], axis=1), len(across))
    in_time = np.column_stack([np.ones(len(across)), grows])  # (F, 3)
    along = np.polynomial.legendre.legvander(2.0 * marker_s - 1.0, _TERMS - 1)  # (m, n)
    basis = np.zeros((*across.shape[:2], 3, 3 * _TERMS))
    basis[:, :, :2] = np.einsum("fmc,ft,mn->fmctn", across, in_time, along).reshape(*across.shape, -1)
    labels = tuple(f"outline error {t}{n}" for t in ("stays", "grows", "grows more") for n in range(_TERMS))
    return Allowance("outline", "poses", "m", labels, np.full(len(labels), OUTLINE_SD), basis, sized=True)


def discrepancy_of(functions: Array, tags: tuple[str, ...], length: float) -> tuple[Allowance, Allowance]:
    """The same of these functions (F, n)."""
    places, angles = (of_axes(functions, len(tags), axes) for axes in (XY, ANGLE))
    place_labels = tuple(f"discrepancy {t} {a}{i}" for a in "xy" for t in tags for i in range(functions.shape[1]))
    angle_labels = tuple(f"discrepancy {t} angle{i}" for t in tags for i in range(functions.shape[1]))
    place_sd = np.full(len(place_labels), PLACE_SD)
    angle_sd = np.full(len(angle_labels), PLACE_SD / (LEVER * length))
    return (
        Allowance("discrepancy", "poses", "m", place_labels, place_sd, places, sized=True),
        Allowance("angle discrepancy", "poses", "rad", angle_labels, angle_sd, angles, sized=True),
    )


def smooth_functions(run: PushCourse) -> Array:
    """(T, 5)."""
    side = run.back - 0.5
    return np.stack([run.bend, run.bend**2, run.bend * side, run.bend**2 * side, run.elapsed], axis=1)


def of_axes(functions: Array, tags: int, axes: tuple[int, ...]) -> Array:
    """(F, m, 3, axes m n): each of the functions (F, n) for each of these coordinates of each tag."""
    frames, n = functions.shape
    out = np.zeros((frames, tags, 3, len(axes), tags, n))
    for i, axis in enumerate(axes):
        for tag in range(tags):
            out[:, tag, axis, i, tag] = functions
    return out.reshape(frames, tags, 3, len(axes) * tags * n)


_WINDOW, _DEGREE = 7, 3  # frames and degree of the polynomial whose curvature is the acceleration
MASS_SD = 25.0  # kg/m^3, of the length cubed: a solid rubber beam, 0.08 by 0.2 of its length thick and wide, has 18


def unknown_mass(observations: Observations, frames: BoolArray, problem: Problem, count: int) -> Allowance | None:
    """The unknown mass [kg] of a moving beam, evenly spread; None where it is stated or no acceleration is known."""
    if observations.static or np.isfinite(observations.stated.mass):
        return None
    force = inertial_force(observations, frames, problem, Uniform(1.0 / observations.length), count)
    if not np.any(force):
        return None
    sd = np.array([MASS_SD * observations.length**3])
    return Allowance("inertia", "load", "kg", ("mass in motion",), sd, force[..., None], shared=True, within=POSITIVE)


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
    """(T, m, 2) m/s^2 by polynomials over a few frames; None for films that are too short, or of uneven frames."""
    if observations.means is not None:
        return observations.means.acceleration
    return second_derivative(observations.time, observations.xy)


def second_derivative(time: Array, values: Array) -> Array | None:
    """(T, ...) of values (T, ...) with `time` (T,), as in `tag_accelerations`; NaN counts as not measured."""
    if len(time) < 2 * _WINDOW:
        return None
    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    if len(even) > 2 * len(time):
        return None
    flat = values.reshape(len(time), -1)
    known = [np.isfinite(column) for column in flat.T]
    if any(np.sum(k) < _WINDOW for k in known):
        return None
    filled = np.stack([np.interp(even, time[k], c[k]) for k, c in zip(known, flat.T, strict=True)], axis=1)
    powers = np.vander((np.arange(_WINDOW) - _WINDOW // 2) * step, _DEGREE + 1, increasing=True)
    weights = 2.0 * np.linalg.pinv(powers)[2]  # of the best polynomial, in the middle (Savitzky, Golay)
    second = np.stack([np.convolve(np.pad(c, _WINDOW // 2, mode="edge"), weights[::-1], "valid") for c in filled.T], 1)
    back = np.stack([np.interp(time, even, c) for c in second.T], axis=1)
    return np.asarray(back.reshape(values.shape))


LENGTH_SD = 0.005  # of the length


def length() -> Allowance:
    """The log of the length, over what is written."""
    return Allowance("length", "length", "1", ("log of length",), np.array([LENGTH_SD]), np.zeros(0), shared=True)


# Each recording has a k(s) of its own around that of the beam, because mounting (clamp, set and temper of the material)
# changes it. With several recordings the evidence chooses how much.

BETWEEN: Literal["between recordings"] = "between recordings"
BETWEEN_SD = np.array([0.05, 0.03, 0.03])  # of log k: level, slope and bow, before the evidence chooses a factor
_SHAPES = Modes(len(BETWEEN_SD))  # Legendre polynomials over the beam


def between_recordings(nodes: Array) -> Allowance:
    """A recording's own level, slope and bow of log k; `nodes` (Q,) or (F, Q) of the beam's grid."""
    labels = tuple(f"own {what} of log k" for what in ("level", "slope", "bow"))
    return Allowance(BETWEEN, "log k", "1", labels, BETWEEN_SD, _SHAPES.curvature(nodes), sized=True)


# Tags are patches that stiffen the beam. Their width is known only by how likely each is: a patch is a sum of layers of
# rising width, one log factor each. At a distance d from a tag's middle log k has the variance `PATCH_SD^2` times the
# probability that the patch reaches d.

PATCH_SD = 0.4  # of the log of the factor on k under a tag, before the evidence has chosen: paper to stiff plastic
SHARES = np.array([0.25, 0.5, 0.25])  # of the widths below
WIDTHS = np.array([1.05, 1.25, 1.6])  # of a patch over the tag's black square: a printed tag has a rim of one cell
PAPER = 1.5  # of the same: wider layers are beyond the paper of a tag
NEXT_TO_NONE = 1e-3
USUAL_SIZE = 0.08  # of the length: a tag's black square where nobody says its size
_USUAL_WIDTHS = np.array([0.8, 1.25, 1.9])  # over `USUAL_SIZE`
_SOFT = 0.04  # of half a width: its edge in s
_FINE = 4001  # places


def patch_functions(marker_s: Array, length: float, tag_size: float, s: Array) -> Array:
    """`s.shape + (3,)`: 1 under the tags, 0 between them, for each width; `tag_size` m, NaN if unknown."""
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


def patches(marker_s: Array, length: float, tag_size: float, grid: Grid | None, *, traced: bool = False) -> Allowance:
    """The layers' factors on k, the same under all tags, for they are alike; no `grid`, no basis. Where the body's
    outline is `traced` beside a tag, k there is seen, and no stiff layer reaches beyond the tag's paper."""
    basis = np.zeros((0, len(WIDTHS))) if grid is None else patch_means(marker_s, length, tag_size, grid)
    labels = tuple(f"log k under the tags, {name}" for name in ("as wide as seen", "and its rim", "and around it"))
    sd = PATCH_SD * np.sqrt(SHARES) * np.where(traced & (WIDTHS > PAPER), NEXT_TO_NONE, 1.0)
    return Allowance("patches", "log k", "1", labels, sd, basis, shared=True, within=POSITIVE, sparse=True)


# Camera: its model puts every tag in one plane. A tag at height z over the plane appears too far from the camera's
# foot, by `z / D` times its distance from there, D being the camera's height. Errors of the plane, focal length and
# lens move all tags of all frames together.

HEIGHT_SD = 2e-3  # m, of each tag over the plane of all
READOUT_SD = 0.015  # s, from the picture's first row to its last
_STEP = 1e-4  # m, to either side of a place, for the slope of a row
_SMALL = np.finfo(float).tiny


def heights(observations: Observations, measured: Array) -> Allowance:
    """Each tag's own height [m], and those of the outline at the clamp and at the tip; `measured` (F, m, 3) poses."""
    view = _view(observations)
    foot, distance = camera_place(view)
    away = np.nan_to_num(measured[..., :2] - foot) / distance
    labels, tags = [f"height of tag {i}" for i in observations.tag_id], tags_among(observations)
    functions = np.eye(len(tags))
    if not tags.all():
        s, labels = observations.marker_s, [labels[i] for i in np.flatnonzero(tags)]
        functions = np.column_stack([functions[:, tags], ~tags * (1.0 - s), ~tags * s])
        labels += ["height of the outline at the clamp", "height of the outline at the tip"]
    basis = np.zeros((*measured.shape, len(labels)))
    basis[:, :, :2] = away[..., None] * functions[:, None, :]
    return Allowance("heights", "poses", "m", tuple(labels), np.full(len(labels), HEIGHT_SD), basis, shared=True)


def camera(observations: Observations, frames: BoolArray, count: int) -> Allowance:
    """The unknowns of the camera and of the tags' plane, in sds; `count` frames, those at rest last.

    The frame is fixed to the base tag and to the tags at rest: their turn is subtracted.
    """
    o = observations
    assert o.by_camera is not None
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


def rolling_shutter(observations: Observations, frames: BoolArray, count: int) -> Allowance:
    """The read-out time [s] of a picture, first row to last: rows, and the corners of a tag, are seen at different
    instants, so moving tags are shifted and turned (half the curl). The principal point is assumed in the middle;
    `count` frames, those at rest last."""
    o = observations
    pose = np.concatenate([o.xy, o.angle[..., None]], axis=-1)
    speed = np.nan_to_num(np.gradient(pose, o.time, axis=0)) if len(o.time) > 1 else np.zeros_like(pose)
    xy, late = np.nan_to_num(o.xy), _row(_view(o))
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


def _view(observations: Observations) -> View:
    assert observations.source.view is not None
    return observations.source.view


POSTURE_SD = 0.01  # of the largest force, for each term and axis; the linear term is a gain: no evidence tells its size
DEGREE = 2  # of the polynomial in the tool's displacement


def posture_bias(run: PushCourse, force: Array) -> Allowance:
    """A polynomial of second degree in the displacement, zero at rest, for each axis of the force (F, 2) [N]."""
    largest = float(np.max(np.linalg.norm(force, axis=1)))
    basis = on_each_axis(with_rest(powers(run.bend), len(force)))
    labels = tuple(f"posture bias {axis}{i}" for axis in "xy" for i in range(1, DEGREE + 1))
    return Allowance("posture", "force", "N", labels, np.full(2 * DEGREE, POSTURE_SD * largest), basis, sparse=True)


def powers(bend: Array) -> Array:
    """(F, 2) of displacements (F,)."""
    return np.stack([bend**i for i in range(1, DEGREE + 1)], axis=1)


def on_each_axis(terms: Array) -> Array:
    """(F, 2, 4): these terms (F, 2) for each axis of the force."""
    return np.asarray(np.einsum("fi,cd->fcdi", terms, np.eye(2)).reshape(len(terms), 2, 2 * DEGREE))


# The material relaxes (generalised Maxwell solid): `M = k_i (q - sum a_j v_j)` with `tau_j v_j' = q - v_j`, fixed times
# tau_j and shares a_j. A static model learned from a push finds the secant modulus `k = k_i (1 - c)`; c is the mean
# part of the curvature that `v = sum a_j v_j` has reached, weighted by its square. The fit's k(s) is the secant one.

TIMES = np.array([1.0, 3.0, 9.0])  # s, tau_j
SHARE_SD = 0.05  # of each a_j: shares of the stiffness that relax
LARGEST = 0.9  # of c: beyond, nothing would be left of the stiffness


def relaxation(run: PushCourse) -> Allowance:
    """The shares that relax with each of the times."""
    labels = tuple(f"share that relaxes within {t:g} s" for t in TIMES)
    return Allowance(
        "relaxation",
        "relaxation",
        "1",
        labels,
        np.full(len(TIMES), SHARE_SD),
        run.time,
        shared=True,
        within=POSITIVE,
        sparse=True,
    )


def lags(time: Array) -> Array:
    """(n, T, T) maps of values, linear in `time` (T,) [s], to their lagged ones, one a time; cached, read only."""
    return _lags(np.asarray(time, dtype=float).tobytes())


@lru_cache(maxsize=4)
def _lags(instants: bytes) -> Array:
    time = np.frombuffer(instants)
    kept, before, now = lag_weights(np.diff(time))
    out = np.zeros((len(TIMES), len(time), len(time)))
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
    out[:count] = (v - reached * q[:count]) / (1.0 - min(reached, LARGEST))
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
    left = 1.0 - min(reached, LARGEST)
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
    all_reached = min(float(shares @ reached), LARGEST)
    away = every @ shares - all_reached * q
    direct = (every - q[..., None] * reached) / (1.0 - all_reached)
    by_shares = direct + away[..., None] * (reached / (1.0 - all_reached) ** 2)
    return away / (1.0 - all_reached), by_shares


# Stretch and shear: 1/EA and 1/kGA follow from k(s) and the section's thickness squared. That square is the parameter,
# so its effect on the tags is linear.

USUAL_THICKNESS = 0.08  # of the length, in the direction of bending
UNKNOWN_SD, KNOWN_SD = 1.2, 0.2  # of the square of the thickness, over the usual or the stated one
_NEAR_NONE = 1e-9  # of it: as good as none, where nothing may be divided by


def section(*, known: bool) -> Allowance:
    """The relative change of the square of the thickness, from the stated one or the usual one."""
    sd = np.array([KNOWN_SD if known else UNKNOWN_SD])
    label = "change of section thickness squared"
    return Allowance("section", "section", "1", (label,), sd, np.zeros(0), shared=True, within=(-1.0, np.inf))


def section_at(change: float, stated: float, beam_length: float) -> tuple[RectangularSection, float]:
    """The section for stretch and shear, and half the derivative of the log of its compliance with the parameter.

    `stated` m, NaN if unknown. Negative compliances are allowed, so that noise is symmetric about zero.
    """
    usual, share = stated if np.isfinite(stated) else USUAL_THICKNESS * beam_length, 1.0 + change
    if abs(share) < _NEAR_NONE:
        share = _NEAR_NONE
    return RectangularSection(usual, share=share), 0.5 / share


AllowanceName = Literal[
    "section",
    "relaxation",
    "slide",
    "clamp gives",
    "posture",
    "patches",
    "length",
    "inertia",
    "gravity direction",
    "heights",
    "camera",
    "rolling shutter",
    "discrepancy",
    "angle discrepancy",
    "outline",
    "between recordings",
]
EVERY_ALLOWANCE: frozenset[AllowanceName] = frozenset(get_args(AllowanceName))
OF_ONE = EVERY_ALLOWANCE - {"between recordings"}  # those that one recording may have


def allowances_of(
    observations: Observations,
    frames: BoolArray,
    measured: Array,
    push_s: Array,
    force: Array,
    grid: Grid,
    wanted: frozenset[AllowanceName],
    across: Array | None = None,
) -> tuple[Allowance, ...]:
    """The wanted allowances of a film's chosen `frames` (T,); none of static poses.

    `measured` (F, m, 3), `push_s` (F,), `force` (F, 2) N and `across` (F, m, 2), unit vectors across an outline at its
    points: of these frames and of the beam at rest after them.
    """
    if observations.static or not np.any(frames):
        return ()
    run, on_body = course(observations, frames), tags_among(observations)
    tags = tuple(f"tag {i}" for i in observations.tag_id[on_body])
    beside = 0 if on_body.all() else int(np.argmin(np.abs(observations.marker_s - CLAMP_TAG)))
    every = [
        section(known=bool(np.isfinite(observations.stated.thickness))),
        relaxation(run),
        length(),
        giving(run, len(force), beside),
    ]
    if tags:
        under = observations.marker_s[on_body], observations.length, observations.stated.tag_size
        every.append(patches(*under, grid, traced=not on_body.all()))
        every += [_at(on_body, one) for one in discrepancy(run, tags, observations.length, len(force))]
    if across is not None and not on_body.all():
        every.append(outline_error(observations.marker_s, run, across))
    if np.any(force != 0.0):
        every += [sliding(observations.marker_s, run, push_s), posture_bias(run, force)]
    if observations.source.view is not None:
        every.append(heights(observations, measured))
        if observations.source.view.matrix[1, 2] > 0.0:  # the picture's rows are known
            every.append(rolling_shutter(observations, frames, len(force)))
    if observations.by_camera is not None:
        every.append(camera(observations, frames, len(force)))
    return tuple(one for one in every if one.name in wanted)


def _at(tags: BoolArray, one: Allowance) -> Allowance:
    """An allowance of the poses of tags, for markers of which `tags` (m,) are these."""
    if tags.all():
        return one
    basis = np.zeros((len(one.basis), len(tags), *one.basis.shape[2:]))
    basis[:, tags] = one.basis
    return replace(one, basis=basis)
