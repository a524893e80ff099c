"""What else the beam, the bench or the tags might do: departures from the fit's model, each a pattern in the tags' poses.

A departure is a few numbers b that the model takes to be zero. To first order it moves the tags by `D b`; D follows
from the equilibrium's derivatives (implicit function theorem) at the optimum. Where the model already has the parameter
under a prior, D is its own column: freeing it asks whether the prior is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.problem import Problem
from onebend.beam.sensitivity import Change, of_clamp_angle, of_moment, of_rest_curvature, respond
from onebend.beam.statics import Equilibrium
from onebend.learning.forward import REST_MODES, Film, Prediction, tag_places
from onebend.learning.parameters import Layout
from onebend.records import Array

Kind = Literal["trend", "prior", "mechanics", "change"]


@dataclass(frozen=True)
class Departure:
    """n numbers that the model takes to be zero, and what they do to one film's tags."""

    key: str  # which test; the same in all films where `recording` is empty
    kind: Kind
    what: str  # "tag 2 along", "stretch", ...
    unit: str  # of b; "" where several units stand together
    pattern: Array  # (F, m, 3, n) m, m, rad per unit


@dataclass(frozen=True)
class Course:
    """How a film runs, F frames each; the frame at rest comes last where there is one."""

    bend: Array  # (F,) 0 to 1, share of the largest bending
    after: Array  # (F,) 1 after the largest bending
    past: Array  # (F,) 0 to 1, share of the bending so far, summed over time
    resting: Array  # (F,) 1 for the frame at rest


def course(seen: Film, now: Prediction) -> Course:
    """From the fitted shapes and the frames' times."""
    time = seen.observations.time[seen.frames]
    frames, count = len(time), len(now.pose)
    q = now.solved.q - now.solved.problem.q0
    bend = np.sqrt(np.mean(q**2, axis=1))
    bend = bend / max(float(np.max(bend)), 1e-300)
    step = np.gradient(time) if frames > 1 else np.ones(frames)
    past, after, resting = np.zeros(count), np.zeros(count), np.zeros(count)
    total = np.cumsum(bend[:frames] * step)
    past[:frames] = total / max(float(total[-1]), 1e-300)
    after[:frames] = np.arange(frames) > int(np.argmax(bend[:frames]))
    resting[frames:] = 1.0
    return Course(bend, after, past, resting)


def departures(seen: Film, at: Layout, x: Array, now: Prediction, several: bool) -> list[Departure]:
    """All that are tested on one film."""
    run = course(seen, now)
    whose = f"{seen.observations.name}: " if several else ""
    stiff, gives = _mechanics(seen, at, x, now, run)
    return [
        *stiff,
        *_changes(seen, at, x, run, gives, whose),
        *_trends(seen, run, whose),
    ]


def _mechanics(
    seen: Film, at: Layout, x: Array, now: Prediction, run: Course
) -> tuple[list[Departure], tuple[Array, Array]]:
    """What the beam and the push may do otherwise; and the patterns of clamp angle (1) and rest shape (3)."""
    solved, problem = now.solved, now.solved.problem
    u, n = _tangents(solved)
    force = problem.dead_force
    pulled, across = np.sum(force * u, axis=-1), np.sum(force * n, axis=-1)
    length = problem.length[..., None]
    stretch, shear = _path(seen, at, x, solved, length * pulled[..., None] * u), None
    shear = _path(seen, at, x, solved, length * across[..., None] * n)
    longer = solved.xy(tag_places(seen, at, x)[0])[..., None]
    none = np.zeros_like(longer)
    pushed = seen.beyond[..., None] * now.force[:, None, :]
    turned = np.stack([-pushed[..., 1], pushed[..., 0]], axis=-1)
    angle = np.take_along_axis(solved.angle(seen.push_s[:, None]), np.zeros((len(force), 1), dtype=int), axis=1)[:, 0]
    along_push = now.force[:, 0] * np.cos(angle) + now.force[:, 1] * np.sin(angle)
    across_push = now.force[:, 1] * np.cos(angle) - now.force[:, 0] * np.sin(angle)
    lever = of_moment(problem, seen.push_s).moment
    assert lever is not None
    shift = float(problem.length) * across_push[:, None, None] * lever
    loaded = (1.0 - run.resting)[:, None]
    sag = (loaded * (1.0 - problem.grid.nodes))[..., None, None] * np.eye(2)
    viscous = _rate(seen, solved)
    changes = {
        "stretch": (_force((pulled * across)[..., None] * n), stretch),
        "shear": (_force(-(pulled * across)[..., None] * n), shear),
        "length": (_force(force), longer),
        "push place": (Change(None, shift, None, np.zeros(1)), none),
        "push beside the axis": (Change(None, -along_push[:, None, None] * lever, None, np.zeros(1)), none),
        "force direction": (_force(turned), none),
        "weight": (Change(sag, None, None, np.zeros(2)), np.repeat(none, 2, axis=-1)),
        "viscous": (Change(None, None, viscous[..., None], np.zeros(1)), none),
        "clamp": (of_clamp_angle(problem), none),
        "rest": (of_rest_curvature(problem, REST_MODES.curvature(problem.grid.nodes)), np.repeat(none, 3, axis=-1)),
    }
    total = None
    for change, _ in changes.values():
        total = change if total is None else total + change
    assert total is not None
    response = respond(solved, total).poses(tag_places(seen, at, x)[0])
    found, start = {}, 0
    for name, (change, more) in changes.items():
        count = len(change.clamp)
        found[name] = _ridden(seen, at, x, solved, response[..., start : start + count], more)
        start += count
    base = np.sum(problem.weights * problem.length * (force[..., 1] * u[..., 0] - force[..., 0] * u[..., 1]), axis=-1)
    units = {
        "stretch": "1/N",
        "shear": "1/N",
        "length": "1",
        "push place": "1",
        "push beside the axis": "m",
        "force direction": "rad",
        "weight": "N",
        "viscous": "N m s",
    }
    out = [Departure(name, "mechanics", name, unit, found[name]) for name, unit in units.items()]
    out.append(
        Departure("clamp gives way", "mechanics", "clamp gives way", "rad/(N m)", base[:, None, None, None] * found["clamp"])
    )
    if at.index["curvature", -1].start < 0:
        out.append(Departure("rest shape", "mechanics", "rest shape", "rad", found["rest"]))
    return out, (found["clamp"], found["rest"])


def _changes(
    seen: Film, at: Layout, x: Array, run: Course, gives: tuple[Array, Array], whose: str
) -> list[Departure]:
    """What may change in the course of one recording: by the bending so far, and after the largest one."""
    clamp, rest = gives
    frames, tags = clamp.shape[:2]
    place = np.zeros((frames, tags, 3, 2))
    place[:, :, 0, 0] = place[:, :, 1, 1] = 1.0
    out = [
        Departure(f"{whose}creep", "change", f"{whose}creep", "", _in_time(rest, run)),
        Departure(f"{whose}slip", "change", f"{whose}slip", "", _in_time(np.concatenate([clamp, place], axis=-1), run)),
    ]
    for i, tag in enumerate(seen.observations.tag_id):
        own = np.zeros((frames, tags, 3, 3))
        own[:, i] = np.eye(3)
        out.append(Departure(f"{whose}loose {tag}", "change", f"{whose}tag {tag}", "", _in_time(own, run)))
    return out


def _trends(seen: Film, run: Course, whose: str) -> list[Departure]:
    """Every coordinate of every tag: smooth in the bending, apart on the way out and back, and in time."""
    side = run.after - 0.5
    smooth = np.stack(
        [run.bend, run.bend**2, run.bend * side, run.bend**2 * side, run.past], axis=1
    ) * (1.0 - run.resting[:, None])
    out = []
    for i, tag in enumerate(seen.observations.tag_id):
        for c, name in enumerate(("x", "y", "angle")):
            pattern = np.zeros((len(run.bend), len(seen.observations.tag_id), 3, smooth.shape[1]))
            pattern[:, i, c] = smooth
            out.append(Departure(f"{whose}trend {tag} {name}", "trend", f"{whose}tag {tag} {name}", "", pattern))
    return out


def _in_time(pattern: Array, run: Course) -> Array:
    """Each column twice: times the bending so far, and after the largest one."""
    return np.concatenate([f[:, None, None, None] * pattern for f in (run.past, run.after)], axis=-1)


def _tangents(solved: Equilibrium) -> tuple[Array, Array]:
    """(F, Q, 2) along and across the beam at the nodes."""
    cos, sin = np.cos(solved.alpha), np.sin(solved.alpha)
    return np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)


def _force(force: Array) -> Change:
    """One parameter that adds the internal force (F, Q, 2)."""
    return Change(force[..., None], None, None, np.zeros(1))


def _path(seen: Film, at: Layout, x: Array, solved: Equilibrium, slope: Array) -> Array:
    """(F, m, 2, 1) integral of `slope` (F, Q, 2) from the clamp to the tags."""
    rows = solved.problem.grid.integral_to(tag_places(seen, at, x)[0])
    return np.stack([apply(rows, slope[..., c]) for c in range(2)], axis=-1)[..., None]


def _rate(seen: Film, solved: Equilibrium) -> Array:
    """(F, Q) rad/s of the curvature; zero at rest."""
    time = seen.observations.time[seen.frames]
    out = np.zeros_like(solved.q)
    if len(time) > 1:
        out[: len(time)] = np.gradient(solved.q[: len(time)], time, axis=0)
    return out


def _ridden(seen: Film, at: Layout, x: Array, solved: Equilibrium, response: Array, more: Array) -> Array:
    """(F, m, 3, n) of the tags, which ride on the beam: places (with `more` of their own) and turns."""
    s, over = tag_places(seen, at, x)
    angle, across = solved.angle(s), at.get(x, "across")
    cos, sin = np.cos(angle), np.sin(angle)
    lever = np.stack([-sin * over - cos * across, cos * over - sin * across], axis=-1)
    turn = response[:, :, 2]
    moved = response[:, :, :2] + more + lever[..., None] * turn[:, :, None, :]
    return np.concatenate([moved, turn[:, :, None, :]], axis=2)
