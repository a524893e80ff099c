"""A recording as the marker-space fit sees it: everything that does not depend on the parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from onebend.beam.grid import Grid, Modes, angles, places, positions
from onebend.beam.loads import Loads, push, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Problem, Resolution, make_problem, share_farther
from onebend.beam.sensitivity import Perturbation, of_mass
from onebend.beam.stiffness import LogSpline, Profile, UncertainStiffness, Uniform
from onebend.errors import LearningError
from onebend.learning import allowances as effects
from onebend.learning.force_error import ForceError, force_error
from onebend.learning.frames import known_loads, mass_profile, pose_whitening, push_places
from onebend.learning.parameters import NEEDS_MASS, KnownShape, Spline, curvature_sd
from onebend.learning.static_poses import HeldEnds, SeenPoses, held_ends, resolution_of, seen_poses
from onebend.recording.signals import low_pass, nan_median
from onebend.recording.tracks import chord_angles
from onebend.records import (
    END_ID,
    Array,
    BoolArray,
    IntArray,
    Observations,
    covariance_with_camera,
    rotated,
    tags_among,
)

# The beam at rest: natural curvature and mounting errors of the tags, separated by their priors. A mounting error turns
# with the beam, so it is subtracted in the tag's own frame.

_REST_MODES = Modes(3)
_EXACT = 1e-6  # m, rad: least sd of a tag's mounting


@dataclass(frozen=True)
class AtRest:
    """The unloaded beam."""

    theta0: Array  # (3,) rad, Legendre states of q0; zeros for a straight beam
    offset: Array  # (m, 2) m, of each tag from its place on the beam, in the beam's tangent frame there
    turn: Array  # (m,) rad, of each tag against the tangent
    seen: bool  # False where no rest frames exist: then all are zero

    def states(self, n: int) -> Array:
        """(n,) rest states for n Legendre modes (cut or filled with zeros)."""
        out = np.zeros(n)
        count = min(n, len(self.theta0))
        out[:count] = self.theta0[:count]
        return out


def at_rest(observations: Observations) -> AtRest:
    """Natural curvature and mounting from the frames before contact (maximum a posteriori, Gauss-Newton)."""
    o, m = observations, len(observations.marker_s)
    known: BoolArray = np.asarray(np.isfinite(o.rest_xy).all(axis=1))
    theta, bent_sd = np.zeros(_REST_MODES.n), curvature_sd(o)
    if not np.any(known):
        return AtRest(theta, np.zeros((m, 2)), np.zeros(m), seen=False)
    if bent_sd > 0.0:
        theta = _rest_states(o, known, bent_sd)
    at = places(o.length, _REST_MODES, o.marker_s)
    alpha = angles(at, theta[None])[0]
    offset = rotated(o.rest_xy - positions(at, theta[None])[0], -alpha)
    turn = np.nan_to_num(o.rest_angle - alpha)  # a marker without an angle has no turn
    return AtRest(theta, np.where(known[:, None], offset, 0.0), np.where(known, turn, 0.0), seen=True)


def beam_points(observations: Observations, rest: AtRest) -> tuple[Array, Array]:
    """Points (T, m, 2) and tangent angles (T, m) of the beam under each tag: mounting errors taken off.

    The offset of a marker without an angle is turned by the angle of the chords beside it.
    """
    tangent = observations.angle - rest.turn
    turned = np.where(np.isfinite(tangent), tangent, chord_angles(observations.xy, observations.marker_s))
    turned = np.where(np.isfinite(turned), turned, 0.0)
    return observations.xy - rotated(rest.offset, turned), tangent


def _rest_states(o: Observations, known: BoolArray, bent_sd: float) -> Array:
    """States that balance curvature (one sd `bent_sd`, rad) against mounting, each measured by its own sd."""
    n, at = _REST_MODES.n, places(o.length, _REST_MODES, o.marker_s[known])
    sd = np.maximum(np.repeat([o.stated.placement_sd, o.stated.turn_sd], [2 * len(at.s), len(at.s)]), _EXACT)
    measured, angle = o.rest_xy[known], o.rest_angle[known]

    def away(theta: Array) -> Array:
        turned = np.nan_to_num(angle - angles(at, theta[None])[0])
        apart = np.concatenate([(measured - positions(at, theta[None])[0]).ravel(), turned])
        return np.concatenate([apart / sd, theta / bent_sd])

    return np.asarray(least_squares(away, np.zeros(n)).x)


# The beam's own weight with a stated spread of the mass: then one number is learned. For one material, `k ~ w^3` and
# mass per metre `mu ~ w` if the size in the plane of bending varies, `mu ~ k` if the other one does, `mu ~ k^(1/2)` if
# both do.

POWERS = {"even": 0.0, "width": 1.0 / 3.0, "thickness": 1.0, "both": 0.5}  # p of `mu ~ k^p`


@dataclass(frozen=True)
class OwnWeight:
    """The weight of one film's frames: F frames, Q nodes, the four parts of the mass (`make_layout`)."""

    gravity: Array  # (F, 2) m/s^2
    modes: Array  # (Q, 4) or (F, Q, 4) kg/m per unit of each part
    weights: Array  # (Q,) or (F, Q) of the nodes
    power: float | None  # of k, where the mass follows it; None: the stated mass is not included

    def force(self, problem: Problem, k: Array, parts: Array) -> Array:
        """(F, Q, 2) N beyond each node."""
        return effects.weight_beyond(problem, self.line(k, parts)[..., None], self.gravity)[..., 0]

    def line(self, k: Array, parts: Array) -> Array:
        """(Q,) or (F, Q) kg/m at the nodes; without the stated mass where it does not follow k."""
        if self.power is not None:
            parts = parts + np.eye(len(parts))[0]
        return np.asarray(self.line_by_mass(k) @ parts)

    def by_mass(self, problem: Problem, k: Array) -> Perturbation:
        """Derivatives with the four parts."""
        return of_mass(problem, self.line_by_mass(k), self.gravity)

    def by_stiffness(self, problem: Problem, k: Array, functions: Array, parts: Array) -> Array | None:
        """(F, Q, 2, p) N, derivatives with the coefficients of log k of `functions` (Q, p) or (F, Q, p)."""
        by_k = self.line_by_stiffness(k, functions, parts)
        return None if by_k is None else effects.weight_beyond(problem, by_k, self.gravity)

    def line_by_stiffness(self, k: Array, functions: Array, parts: Array) -> Array | None:
        """(Q, p) or (F, Q, p) kg/m, derivatives as above; None where the mass does not follow k."""
        if not self.power:
            return None
        line = (1.0 + parts[0]) * self.line_by_mass(k)[..., 0]
        share = self.weights * line / np.sum(self.weights * line, axis=-1, keepdims=True)
        mean = np.sum(share[..., None] * functions, axis=-2, keepdims=True)
        return np.asarray(self.power * line[..., None] * (functions - mean))

    def line_by_mass(self, k: Array) -> Array:
        """(Q, 4) or (F, Q, 4) kg/m at the nodes per unit of each part."""
        if self.power is None:
            return self.modes
        share = k**self.power
        share = share / np.sum(self.weights * share, axis=-1, keepdims=True)
        modes = np.broadcast_to(self.modes, (*share.shape, self.modes.shape[-1])).copy()
        modes[..., 0] *= share
        return modes


def own_weight(o: Observations, grid: Grid, gravity: Array, even: Array, written: Profile) -> OwnWeight:
    """Of a recording whose mass is known or guessed; `even` (Q, 4) or (F, Q, 4): Legendre functions at the nodes."""
    modes = o.stated.mass / o.length * even
    if o.stated.mass_along in ("section", "table"):  # the whole of it is heavier or lighter
        modes = np.concatenate([np.asarray(written(grid.nodes))[..., None], modes[..., 1:]], axis=-1)
    return OwnWeight(gravity, modes, grid.weights, POWERS.get(o.stated.mass_along))


def following(o: Observations, stiffness: UncertainStiffness, mass: float) -> Profile | None:
    """kg/m of `mass` [kg] where it follows k(s); None where it does not."""
    power = POWERS.get(o.stated.mass_along)
    if power is None:
        return None
    if power == 0.0:
        return Uniform(mass / o.length)
    s = np.linspace(0.0, 1.0, 2001)
    total = float(np.trapezoid(stiffness.profile(s) ** power, s))
    logs = power * stiffness.mean + np.log(mass / o.length / total)
    offset = stiffness.offset
    if offset is not None:
        offset = replace(offset, values=tuple(power * value for value in offset.values))
    return LogSpline(tuple(stiffness.knots.tolist()), tuple(logs.tolist()), stiffness.degree, offset)


REST_MODES = Modes(3)
MASS_MODES = Modes(4)
_SLOW = 0.5  # of the cut-off


@dataclass(frozen=True)
class FitData:
    """One recording as the fit sees it: F frames, the last being the beam at rest where it was seen."""

    observations: Observations
    number: int
    frames: BoolArray  # (T,) which frames of the recording are used
    measured: Array  # (F, m, 3) x, y, angle; NaN where missing
    whiten: Array  # (F, m, 3, 3) or (F, 3 m, 3 m), see `pose_whitening`; zero where missing
    tags: IntArray  # (k,) which of the m markers are tags; the others are points of an outline
    across: Array  # (F, m, 2) unit vectors across the outline at its points; zeros at tags
    rulers: Array | None  # (F, m) m: where rulers stand; None: points are marks on the beam
    force: Array  # (F, 2) N as logged
    rate: Array  # (F, 2) N/s, derivative of the logged force
    error: ForceError
    error_weights: Array  # (F, K)
    push_s: Array  # (F,)
    problem: Problem  # grid and what does not change
    beyond: Array  # (F, Q) 1 where the push lies beyond the node; 0 at rest, where nothing pushes
    farther: Array  # (F, Q) 1/m: what is added to it where the push lies farther out; see `share_farther`
    weight: Array  # (F, Q, 2) N beyond the node: weight, the mass as written down, and the loads known besides
    ends: HeldEnds | None  # of frames whose end an unknown wrench holds
    poses: SeenPoses | None  # which equilibrium each is in; None: the one that grows from rest
    mass: OwnWeight | None  # what the mass has besides; None where nothing weighs
    on_nodes: Array  # (Q, p) or (F, Q, p): the spline's functions at the nodes
    offset: Array  # (Q,) or (F, Q): what is known of log k there, but for its level
    rest_on_nodes: Array  # (Q, 3) or (F, Q, 3)
    allowances: tuple[effects.Allowance, ...] = ()
    memory: effects.MaterialMemory | None = None  # of a beam that relaxes, where earlier frames are not among these

    @property
    def resting(self) -> BoolArray:
        """(F,) which frame shows the beam at rest."""
        return np.asarray(np.arange(len(self.measured)) >= np.sum(self.frames))

    def of_tags(self, values: Array) -> Array:
        """(m,) values of the tags (k,); zero at points of an outline."""
        out = np.zeros(self.measured.shape[1])
        out[self.tags] = values
        return out

    def off(self, pose: Array) -> Array:
        """(F, m, 2) m from poses (F, m, 3) to what was measured; of an outline's points what is across it."""
        away = (self.measured - pose)[..., :2]
        across = np.sum(away * self.across, axis=-1, keepdims=True) * self.across
        return np.where(np.any(self.across, axis=-1, keepdims=True), across, away)

    def entering(self, enters: effects.Entry) -> list[effects.Allowance]:
        """The allowances that enter the model here."""
        return [a for a in self.allowances if a.enters == enters]


def fit_data(
    observations: Observations,
    number: int,
    frames: BoolArray,
    spline: Spline,
    allowances: frozenset[str] = frozenset(),
    known: KnownShape | None = None,
    resolution: Resolution | None = None,
) -> FitData:
    """Prepare a recording; `allowances` by name, `known`: the stated shape of k, `resolution`: of the beam, if unusual.

    Raises:
        LearningError: weight acts and the mass is unknown.
    """
    o = observations
    time = o.time[frames]
    error = force_error(o, time)
    measured = np.concatenate([o.xy[frames], o.angle[frames][..., None]], axis=-1)
    rulers = None
    if o.readings.at == "x":
        rulers, measured[..., 0] = measured[..., 0].copy(), np.nan
    all_noise = o.covariance if "camera" in allowances else covariance_with_camera(o)
    covariance, force = all_noise[frames], o.force[frames]
    rate = _rate(o)[frames]
    push_s, gravity, weights = push_places(o)[frames], o.gravity[frames], error.weights
    other = known_loads(o, frames)
    if np.any(np.isfinite(o.rest_xy)):  # the beam at rest is one more frame, of no force and no force error
        rest = np.concatenate([o.rest_xy, o.rest_angle[:, None]], axis=1)
        measured = np.concatenate([measured, rest[None]])
        covariance = np.concatenate([covariance, np.maximum(nan_median(all_noise), 0.0)[None] * np.eye(3)])
        force, rate = np.vstack([force, np.zeros(2)]), np.vstack([rate, np.zeros(2)])
        push_s, gravity = np.append(push_s, push_s[-1]), np.vstack([gravity, np.zeros(2)])
        weights = np.vstack([weights, np.zeros(weights.shape[1])])
        other = rested(other)
    tags, across = tags_among(o), np.zeros((*measured.shape[:2], 2))
    direction = np.nan_to_num(measured[:, ~tags, 2]) - 0.5 * np.pi * (o.tag_id[~tags] == END_ID)
    across[:, ~tags] = np.stack([-np.sin(direction), np.cos(direction)], axis=-1)
    measured[:, ~tags, 2] = np.nan
    whiten = pose_whitening(o, measured, covariance, across)
    weighs = bool(np.any(gravity != 0.0))
    if weighs and not np.isfinite(o.stated.mass):
        raise LearningError(f"{o.source.name}: {NEEDS_MASS}")
    line = mass_profile(o)
    written = line if weighs and o.stated.mass_along not in POWERS else Uniform(0.0)
    known = KnownShape(None, 0.0) if known is None else known
    carrier = Beam(o.length, known.profile, mass_per_length=written, masses=o.stated.masses)
    problem = make_problem(
        carrier, push(np.zeros_like(force), push_s) + weight(gravity) + other, resolution or resolution_of(o)
    )
    ends = held_ends(o, frames, problem)
    nodes = problem.grid.nodes
    film = effects.Film(o, frames, measured, problem, gravity, line, rate)
    none = not allowances or o.static or not np.any(frames)
    known_mass = bool(allowances) and (np.isfinite(o.stated.mass) or o.stated.masses) and not o.static
    inertia = (
        effects.inertial_force(o, frames, problem, line, len(force), o.stated.masses) if known_mass else np.zeros(1)
    )
    return FitData(
        observations=o,
        number=number,
        frames=frames,
        measured=measured,
        whiten=whiten,
        tags=np.flatnonzero(tags),
        across=across,
        rulers=rulers,
        force=force,
        rate=rate,
        error=error,
        error_weights=weights,
        push_s=push_s,
        problem=problem,
        beyond=(nodes < push_s[:, None]) * (np.arange(len(force)) < len(time))[:, None].astype(float),
        farther=share_farther(problem, push_s),
        weight=problem.dead_force + inertia,
        ends=ends,
        poses=seen_poses(o, frames),
        mass=own_weight(o, problem.grid, gravity, MASS_MODES.curvature(nodes), line) if weighs else None,
        on_nodes=spline.basis(nodes),
        offset=known.offset_at(nodes),
        rest_on_nodes=REST_MODES.curvature(nodes),
        allowances=() if none else effects.allowances_of(effects.course_of(o, frames, film, across), allowances),
    )


def _rate(o: Observations) -> Array:
    """(T, 2) N/s: slope of the low-passed force at the frames; noise in it would bias the clock offset to zero."""
    if o.source.clean_force is None:
        return np.gradient(o.force, o.time, axis=0) if len(o.time) > 1 else np.zeros_like(o.force)
    clean = o.source.clean_force
    known = np.all(np.isfinite(clean.force), axis=1)
    time = clean.time[known]
    slow = low_pass(time, clean.force[known], _SLOW * clean.cutoff, longest_gap=np.inf)
    slope = np.gradient(slow, time, axis=0)
    return np.stack([np.interp(o.time, time, slope[:, c]) for c in range(2)], axis=1)


def rested(loads: Loads) -> Loads:
    """One frame more, in which nothing acts."""
    if loads.size == 1:
        return loads
    more = loads.take(np.append(np.arange(loads.size), loads.size - 1))
    here = (np.arange(more.size) < loads.size).astype(float)
    return replace(more, force=more.force * here[:, None, None], moment=more.moment * here[:, None])
