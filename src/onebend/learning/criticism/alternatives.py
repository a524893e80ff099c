"""What else beam, bench and tags might do: departures from the fit's model, each a pattern in the tags' poses.

A departure is a few numbers b that the model takes to be zero. To first order it moves the tags by `D b`; D follows
from the equilibrium's derivatives (implicit function theorem) at the optimum. Where the model already has the parameter
under a prior, D is its own column: freeing it asks whether the prior is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.perturbation import Perturbation, Perturbations
from onebend.beam.statics.sensitivity import of_clamp_angle, of_moment, of_rest_curvature, respond
from onebend.learning.model.fit_data import REST_MODES, Film
from onebend.learning.model.forward import Prediction, tag_places
from onebend.learning.model.parameters import Layout
from onebend.records import Array

Kind = Literal["prior", "mechanics", "change", "trend"]

UNITS = {  # of what the beam and the push may do otherwise
    "stretch": "1/N",
    "shear": "1/N",
    "length": "1",
    "push place": "1",
    "push beside": "m",
    "force direction": "rad",
    "weight": "N",
    "viscous": "N m s",
    "clamp gives": "rad/(N m)",
    "rest shape": "rad",
}
AXES = ("x", "y", "angle")


@dataclass(frozen=True)
class Suspect:
    """What may be otherwise than the model takes it to be."""

    kind: Kind
    name: str
    tag: int = -1  # its id; -1: no tag's own
    recording: str = ""  # empty: of the beam, alike in all recordings


@dataclass(frozen=True)
class Departure:
    """n numbers that the model takes to be zero, and what they do to one film's tags."""

    suspect: Suspect
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


def departures(seen: Film, at: Layout, x: Array, now: Prediction) -> list[Departure]:
    """All that are tested on one film."""
    run, found = course(seen, now), mechanics(seen, at, x, now)
    pliant = found["clamp"] * _clamp_moment(now.solved)[:, None, None, None]
    wanted = {name: found[name] for name in UNITS if name in found} | {"clamp gives": pliant}
    if at.index["curvature", -1].start >= 0:
        del wanted["rest shape"]
    if seen.observations.static:  # poses have no order in time
        del wanted["viscous"]
        return [Departure(Suspect("mechanics", name), pattern) for name, pattern in wanted.items()]
    stiff = [Departure(Suspect("mechanics", name), pattern) for name, pattern in wanted.items()]
    return [*stiff, *_changes(seen, run, found), *_trends(seen, run)]


def mechanics(seen: Film, at: Layout, x: Array, now: Prediction) -> dict[str, Array]:
    """(F, m, 3, n) per unit of what `UNITS` names, and of the clamp's angle ("clamp")."""
    changes = _entering(seen, now)
    carried = _carried(seen, at, x, now)
    everything = Perturbations(tuple(changes.values()))
    response = respond(now.solved, everything).poses(tag_places(seen, at, x)[0])
    found, start = {}, 0
    for name, change in changes.items():
        part = response[..., start : start + len(change.clamp)].copy()
        if name in carried:
            part[:, :, :2] += carried[name][..., None]
        found[name] = _ridden(seen, at, x, now.solved, part)
        start += len(change.clamp)
    return found


def _entering(seen: Film, now: Prediction) -> dict[str, Perturbation]:
    """How the departures enter the balance of moments. With N = (N_u, N_n) along and across, `M' = -L N_n`.

    A stretch e = N_u / (E A) makes it -L (1 + e) N_n, a shear g = N_n / (G A) adds L g N_u (Reissner's beam).
    """
    solved, problem = now.solved, now.solved.problem
    u, n = _tangents(solved)
    force = problem.dead_force
    product = (np.sum(force * u, axis=-1) * np.sum(force * n, axis=-1))[..., None] * n
    pushed = seen.beyond[..., None] * now.force[:, None, :]
    turned = np.stack([-pushed[..., 1], pushed[..., 0]], axis=-1)
    angle = solved.angle(seen.push_s[:, None])[:, 0]
    cos, sin = np.cos(angle), np.sin(angle)
    along, across = (now.force[:, 0] * a + now.force[:, 1] * b for a, b in ((cos, sin), (-sin, cos)))
    lever = of_moment(problem, seen.push_s).moment
    assert lever is not None
    loaded = (np.arange(len(force)) < int(np.sum(seen.frames))).astype(float)
    sag = (loaded[:, None] * (1.0 - problem.grid.nodes))[..., None, None] * np.eye(2)
    return {
        "stretch": _force(product),
        "shear": _force(-product),
        "length": _force(force),
        "push place": Perturbation(None, float(problem.length) * across[:, None, None] * lever, None, np.zeros(1)),
        "push beside": Perturbation(None, -along[:, None, None] * lever, None, np.zeros(1)),
        "force direction": _force(turned),
        "weight": Perturbation(sag, None, None, np.zeros(2)),
        "viscous": Perturbation(None, None, (_rate(seen, solved), np.ones((force.shape[1], 1))), np.zeros(1)),
        "clamp": of_clamp_angle(problem),
        "rest shape": of_rest_curvature(problem, REST_MODES.curvature(problem.grid.nodes)),
    }


def _carried(seen: Film, at: Layout, x: Array, now: Prediction) -> dict[str, Array]:
    """(F, m, 2) m per unit that the tags move by without a turn of the beam: `r' = L (1 + e) u + L g n`."""
    solved, s = now.solved, tag_places(seen, at, x)[0]
    u, n = _tangents(solved)
    force, rows = solved.problem.dead_force, solved.problem.grid.integral_to(s)
    length = float(solved.problem.length)

    def path(slope: Array) -> Array:
        return np.stack([apply(rows, slope[..., c]) for c in range(2)], axis=-1)

    return {
        "stretch": length * path(np.sum(force * u, axis=-1)[..., None] * u),
        "shear": length * path(np.sum(force * n, axis=-1)[..., None] * n),
        "length": solved.xy(s),
    }


def _clamp_moment(solved: Equilibrium) -> Array:
    """(F,) N m that the loads bend the clamp with."""
    problem, (_, n) = solved.problem, _tangents(solved)
    return np.asarray(np.sum(problem.length * problem.weights * np.sum(problem.dead_force * n, axis=-1), axis=-1))


def _changes(seen: Film, run: Course, found: dict[str, Array]) -> list[Departure]:
    """What may change in the course of one recording: by the bending so far, and after the largest one."""
    name = seen.observations.name
    frames, tags = found["clamp"].shape[:2]
    place = np.zeros((frames, tags, 3, 2))
    place[:, :, 0, 0] = place[:, :, 1, 1] = 1.0
    slip = np.concatenate([found["clamp"], place], axis=-1)
    out = [
        Departure(Suspect("change", "creep", recording=name), _in_time(found["rest shape"], run)),
        Departure(Suspect("change", "slip", recording=name), _in_time(slip, run)),
    ]
    for i, tag in enumerate(seen.observations.tag_id.tolist()):
        own = np.zeros((frames, tags, 3, 3))
        own[:, i] = np.eye(3)
        out.append(Departure(Suspect("change", "loose", tag, name), _in_time(own, run)))
    return out


def _trends(seen: Film, run: Course) -> list[Departure]:
    """Every coordinate of every tag: smooth in the bending, apart on the way out and back, and in time."""
    side, tags = run.after - 0.5, seen.observations.tag_id.tolist()
    smooth = [run.bend, run.bend**2, run.bend * side, run.bend**2 * side, run.past]
    functions = np.stack(smooth, axis=1) * (1.0 - run.resting[:, None])
    out = []
    for i, tag in enumerate(tags):
        for c, axis in enumerate(AXES):
            pattern = np.zeros((len(run.bend), len(tags), 3, len(smooth)))
            pattern[:, i, c] = functions
            out.append(Departure(Suspect("trend", axis, tag, seen.observations.name), pattern))
    return out


def _in_time(pattern: Array, run: Course) -> Array:
    """Each column twice: times the bending so far, and after the largest one."""
    return np.concatenate([f[:, None, None, None] * pattern for f in (run.past, run.after)], axis=-1)


def _tangents(solved: Equilibrium) -> tuple[Array, Array]:
    """(F, Q, 2) along and across the beam at the nodes."""
    cos, sin = np.cos(solved.alpha), np.sin(solved.alpha)
    return np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)


def _force(force: Array) -> Perturbation:
    """One parameter that adds the internal force (F, Q, 2)."""
    return Perturbation(force[..., None], None, None, np.zeros(1))


def _rate(seen: Film, solved: Equilibrium) -> Array:
    """(F, Q) rad/s of the curvature; zero at rest."""
    time = seen.observations.time[seen.frames]
    out = np.zeros_like(solved.q)
    if len(time) > 1:
        out[: len(time)] = np.gradient(solved.q[: len(time)], time, axis=0)
    return out


def _ridden(seen: Film, at: Layout, x: Array, solved: Equilibrium, response: Array) -> Array:
    """(F, m, 3, n) of the tags, which ride on the beam, from that of the beam's places under them."""
    s, over = tag_places(seen, at, x)
    angle, across = solved.angle(s), at.get(x, "across")
    cos, sin = np.cos(angle), np.sin(angle)
    lever = np.stack([-sin * over - cos * across, cos * over - sin * across], axis=-1)
    turn = response[:, :, 2:]
    return np.concatenate([response[:, :, :2] + lever[..., None] * turn, turn], axis=2)
