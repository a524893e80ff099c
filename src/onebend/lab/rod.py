"""A beam that stretches, shears and relaxes, through a push in time; independent of `beam.statics`.

The beam is cut into some 800 straight cells of angle a_j that turn against each other at joints:

    M_j = K_j (u_j - a v_j),   u_j = a_{j+1} - a_j - rest,   tau v_j' = u_j - v_j,   1/K_j = int ds / k between middles
    M_j - M_{j-1} = -L h_j (r' x n),   r' = (1 + N/EA) d1 + (Q/kGA) d2,   N = n . d1,   Q = n . d2

(the rod of Simo and Reissner in a standard linear solid, with elastic axial and shear flexibility). The clamp is a
joint of its own. v is integrated exactly for u linear in time. Newton's method solves the tridiagonal equations at each
time. Inertia is mass times the acceleration of the inertia-free motion: first order in the square of the push's
frequency over the beam's, without swinging. Errors fall with the square of the cell size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg.lapack import dgtsv

from onebend.beam.model import Beam
from onebend.errors import MechanicsError
from onebend.lab.bench import RealBench, instant_stiffness, patch_ends, rest_curvature, section_flexibility
from onebend.records import Array

CELLS = 800
STEP = 1.0 / 60.0  # s, largest
MOST_ITERATIONS = 40
TOLERANCE = 1e-10  # rad
LARGEST_TURN = 0.5  # rad, of a cell per time step; more means snap-through
RIGID = 1e-9  # compliance of a rigid clamp relative to the beam's 1/k
WEIGHT_STEPS = 16


@dataclass(frozen=True)
class RodTask:
    """A beam, its effects and its load."""

    beam: Beam
    effects: RealBench
    tags: Array  # (m,) s, true places
    force: Callable[[Array], Array]  # (T,) s -> (T, 2) N
    at_s: float  # stated place of the push
    until: float  # s
    gravity: tuple[float, float] = (0.0, 0.0)  # m/s^2


@dataclass(frozen=True)
class RodMotion:
    """T even times from 0; N + 1 ends of cells."""

    time: Array  # (T,) s
    s: Array  # (N + 1,)
    pose: Array  # (T, N + 1, 3) m, m, rad
    contact: Array  # (T,) s, place of the push
    secant: float  # secant over instantaneous modulus: least squares of M on the turns of the whole push

    def poses(self, time: Array, s: Array) -> Array:
        """(T', S, 3) at any times by a cubic spline; `s` (S,) at cell ends, else by cubics."""
        node = np.clip(np.searchsorted(self.s, s - 1e-9), 0, len(self.s) - 1)
        exact = bool(np.all(np.abs(self.s[node] - s) < 1e-9))
        at_s = self.pose[:, node] if exact else CubicSpline(self.s, self.pose, axis=1)(s)
        return np.asarray(CubicSpline(self.time, at_s)(np.clip(time, 0.0, self.time[-1])))

    def contacts(self, time: Array) -> Array:
        """(T',) s, place of the push."""
        return np.interp(time, self.time, self.contact)

    @property
    def tool(self) -> Array:
        """(T, 2) m, the place of the push."""
        cell = np.clip(np.searchsorted(self.s, self.contact, side="right") - 1, 0, len(self.s) - 2)
        share = (self.contact - self.s[cell]) / (self.s[cell + 1] - self.s[cell])
        frame, xy = np.arange(len(self.time)), self.pose[..., :2]
        return np.asarray((1.0 - share)[:, None] * xy[frame, cell] + share[:, None] * xy[frame, cell + 1])


@dataclass(frozen=True)
class _Cells:
    """Cells and joints; joint 0 is at the clamp, joint j after cell j."""

    length: float  # m
    edges: Array  # (N + 1,)
    size: Array  # (N,) in s
    joint: Array  # (N,) N m/rad, joints 0 to N - 1
    rest: Array  # (N,) rad, their turn at rest
    to_edge: Array  # (N,) share of a joint's turn before its edge
    clamp: float  # N m/rad
    stretch: Array  # (N,) 1/N
    shear: Array  # (N,) 1/N
    mass: Array  # (N,) kg


def march(task: RodTask, step: float = STEP, *, at: Array | None = None) -> RodMotion:
    """Follow the push from rest in even steps of at most `step` [s]; cells end at `at` too. Raises `MechanicsError`:
    snap-through, or inertia or weight with an unknown mass."""
    count = int(np.ceil(task.until / step - 1e-9))
    time: Array = step * np.arange(count + 1, dtype=float)
    cells = cells_of(task, at)
    heavy = task.effects.inertia or any(task.gravity)
    if heavy and not float(np.min(cells.mass)) > 0.0:
        raise MechanicsError("a beam without mass has neither weight nor inertia. Give it a mass per length")
    own = cells.mass[None, :, None] * np.asarray(task.gravity) * np.ones((len(time), 1, 1))
    motion = follow(task, cells, time, own)
    if not task.effects.inertia:
        return motion
    middle = 0.5 * (motion.pose[:, 1:, :2] + motion.pose[:, :-1, :2])
    acceleration = CubicSpline(time, middle).derivative(2)(time)
    return follow(task, cells, time, own - cells.mass[None, :, None] * acceleration)


def cells_of(task: RodTask, at: Array | None) -> _Cells:
    """Cells that end at every jump of k, patch end, tag, and the place of the push."""
    beam, effects = task.beam, task.effects
    patches = patch_ends(effects, beam.length, task.tags)
    even = np.linspace(0.0, 1.0, CELLS + 1)
    more = [
        np.clip(task.tags, 0.0, 1.0),
        np.clip(patches.ravel(), 0.0, 1.0),
        beam.stiffness.jumps,
        [task.at_s],
        [] if at is None else at,
    ]
    edges = np.unique(np.concatenate([even, *(np.asarray(part, dtype=float) for part in more)]))
    edges = edges[np.concatenate([[True], np.diff(edges) > 1e-9])]
    size, middle = np.diff(edges), 0.5 * (edges[1:] + edges[:-1])
    half = 0.5 * size / instant_stiffness(beam, effects, task.tags, middle)
    turn = 0.5 * size * rest_curvature(beam, effects, middle)
    before = np.concatenate([[0.0], half[:-1]])
    flexibility = before + half
    stretch, shear = section_flexibility(beam, effects, middle)
    mean = float(np.sum(size / half)) / 2.0 / len(size)
    return _Cells(
        length=beam.length,
        edges=edges,
        size=size,
        joint=1.0 / flexibility,
        rest=np.concatenate([[0.0], turn[:-1]]) + turn,
        to_edge=before / flexibility,
        clamp=float(1.0 / max(effects.clamp_compliance, RIGID / mean)),
        stretch=stretch,
        shear=shear,
        mass=np.asarray(beam.mass_per_length(middle)) * size * beam.length,
    )


def follow(task: RodTask, cells: _Cells, time: Array, carried: Array) -> RodMotion:
    """One pass over all times, with forces `carried` (T, N, 2) [N] on the cells."""
    effects, force = task.effects, task.force(time)
    share, (decay, old, new) = effects.relaxation, relaxation(effects, time[1] - time[0])
    contact = contact_of(task, cells)
    beyond = np.cumsum(carried[:, ::-1], axis=1)[:, ::-1] - 0.5 * carried  # force held at each cell's middle
    angle = contact.rest
    for part in np.arange(1, WEIGHT_STEPS) / WEIGHT_STEPS if np.any(beyond[0]) else ():
        angle, _ = balanced(cells, contact, angle, part * force[0], part * beyond[0], np.zeros(len(cells.size)), share)
    turned = lagged = np.zeros(len(cells.size))
    pose, places, work = [], [], np.zeros(2)
    for i in range(len(time)):
        held, now = (decay * lagged + old * turned, new) if i else (lagged, 1.0)  # relaxed at first
        angle, place = balanced(cells, contact, angle, force[i], beyond[i], share * held, share * now)
        turned = np.diff(angle) - cells.rest
        lagged = held + now * turned
        work += [float(cells.joint @ (turned * (turned - share * lagged))), float(cells.joint @ turned**2)]
        pose.append(poses_of(cells, angle, force[i] * contact.loaded(place)[:, None] + beyond[i]))
        places.append(place)
    secant = float(work[0] / work[1]) if share and work[1] > 0.0 else 1.0
    return RodMotion(time, cells.edges, np.stack(pose), np.array(places), secant)


def relaxation(effects: RealBench, step: float) -> tuple[float, float, float]:
    """Shares decay, old, new of v' = decay v + old u + new u' after a `step` [s] in which u is linear."""
    decay = float(np.exp(-step / effects.relaxation_time))
    ramp = (1.0 - decay) * effects.relaxation_time / step
    return decay, ramp - decay, 1.0 - ramp


@dataclass(frozen=True)
class _Contact:
    """The place of the push as the beam turns."""

    rest: Array  # (N + 1,) rad, unloaded angles of clamp and cells
    start: float  # s
    slide: float  # in s per rad
    edges: Array  # (N + 1,) s
    middle: Array  # (N + 1,) s, clamp and cells

    def place(self, angle: Array) -> float:
        """s: it slides by `slide` per radian of turn at its first place, staying on the beam."""
        if self.slide == 0.0:
            return self.start
        turn = float(np.interp(self.start, self.middle, angle - self.rest))
        return float(np.clip(self.start + self.slide * turn, 0.0, 1.0))

    def loaded(self, place: float) -> Array:
        """(N,) share of each cell that carries the push."""
        return np.asarray(np.clip((place - self.edges[:-1]) / np.diff(self.edges), 0.0, 1.0))


def contact_of(task: RodTask, cells: _Cells) -> _Contact:
    length = task.beam.length
    return _Contact(
        rest=task.beam.clamp_angle + np.concatenate([[0.0], np.cumsum(cells.rest)]),
        start=float(np.clip(task.at_s + task.effects.push_off / length, 0.0, 1.0)),
        slide=task.effects.slide / length,
        edges=cells.edges,
        middle=np.concatenate([[0.0], 0.5 * (cells.edges[1:] + cells.edges[:-1])]),
    )


def balanced(
    cells: _Cells, contact: _Contact, angle: Array, force: Array, beyond: Array, offset: Array, part: float
) -> tuple[Array, float]:
    """Equilibrium angles (N + 1,) [rad] of clamp and cells, and the place of the push.

    Moments are joint ((1 - part) u - offset); `part` and `offset` (N,) describe the relaxation.
    """
    begin = angle
    arm, mixed = cells.length * cells.size, cells.stretch - cells.shear
    stiffness = (1.0 - part) * cells.joint
    fixed = -np.concatenate([[cells.clamp], stiffness]) - np.concatenate([stiffness, [0.0]])
    place = contact.place(angle)
    held = force * contact.loaded(place)[:, None] + beyond
    for _ in range(MOST_ITERATIONS):
        cos, sin = np.cos(angle[1:]), np.sin(angle[1:])
        along, across = held[:, 0] * cos + held[:, 1] * sin, held[:, 1] * cos - held[:, 0] * sin
        moment = stiffness * (np.diff(angle) - cells.rest) - cells.joint * offset
        left = np.concatenate([[cells.clamp * (angle[0] - contact.rest[0])], moment])
        residual = np.concatenate([moment, [0.0]]) - left
        residual[1:] += arm * across * (1.0 + along * mixed)
        middle = fixed.copy()
        middle[1:] += arm * (-along + mixed * (across**2 - along**2))
        change = dgtsv(stiffness, middle, stiffness, -residual)[3]
        angle = angle + change
        before, place = place, contact.place(angle)
        if not np.all(np.abs(angle - begin) < LARGEST_TURN):
            break
        if np.max(np.abs(change)) < TOLERANCE and abs(place - before) < TOLERANCE:
            return angle, place
        if place != before:
            held = force * contact.loaded(place)[:, None] + beyond
    raise MechanicsError("the virtual beam snaps through under this push. Give a smaller one")


def poses_of(cells: _Cells, angle: Array, held: Array) -> Array:
    """(N + 1, 3) m, m, rad at the cells' ends, with cell forces (N, 2)."""
    cos, sin = np.cos(angle[1:]), np.sin(angle[1:])
    along, across = held[:, 0] * cos + held[:, 1] * sin, held[:, 1] * cos - held[:, 0] * sin
    stretched, sheared = 1.0 + along * cells.stretch, across * cells.shear
    way = np.stack([stretched * cos - sheared * sin, stretched * sin + sheared * cos], axis=-1)
    xy = np.concatenate([np.zeros((1, 2)), np.cumsum(cells.length * cells.size[:, None] * way, axis=0)])
    turn = np.diff(angle)
    at_edges = np.append(angle[:-1] + cells.to_edge * turn, angle[-1] + 0.5 * cells.rest[-1])
    return np.concatenate([xy, at_edges[:, None]], axis=-1)
