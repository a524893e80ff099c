"""What else beam, clamp, sensors and tags might do: alternatives to the fit's model, each a pattern in the tags' poses.

An alternative is a few numbers b that the model takes to be zero. To first order it moves the tags by `D b`; D follows
from the equilibrium's derivatives (implicit function theorem) at the optimum. A parameter that the model has under a
prior is no pattern of its own: freeing it asks whether the prior is wrong (`score_tests.pulls`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.perturbation import Perturbation
from onebend.beam.statics.sensitivity import of_clamp_angle, of_rest_curvature, of_stiffness
from onebend.learning.model.fit_data import REST_MODES, FitData
from onebend.learning.model.forward import Prediction, tag_places, tag_ride
from onebend.learning.model.parameters import Layout
from onebend.learning.model.tag_jacobian import along_and_across, place_responses, push_moment
from onebend.records import Array

Kind = Literal["prior", "mechanics", "change", "trend"]

UNITS = {  # of what the beam and the push may do otherwise
    "stretch": "1/N",
    "shear": "1/N",
    "length": "1",
    "push place": "1",
    "push beside": "m",
    "force direction": "rad",
    "axis scale": "1",
    "weight": "N",
    "viscous": "N m s",
    "clamp gives": "rad/(N m)",
    "rest shape": "rad",
    "stiffness along": "1",
}
_ALLOWED = {  # what the fit may allow for, and what need not be tested then
    "section": ("stretch", "shear"),
    "length": ("length",),
    "relaxation": ("viscous",),
    "clamp gives": ("clamp gives",),
}
AXES = ("x", "y", "angle")
_ALONG = 3  # Legendre polynomials, from the slope on, that log k may have beside a shape that is stated


@dataclass(frozen=True)
class Suspect:
    """What may be otherwise than the model takes it to be."""

    kind: Kind
    name: str
    tag: int = -1  # its id; -1: no tag's own
    recording: str = ""  # empty: of the beam, alike in all recordings


@dataclass(frozen=True)
class Alternative:
    """n numbers that the model takes to be zero, and what they do to one film's tags."""

    suspect: Suspect
    pattern: Array  # (F, m, 3, n) m, m, rad per unit
    log_k: Array | None = None  # (p, n) what they are of log k's coefficients; None: nothing


@dataclass(frozen=True)
class Course:
    """How a film runs, F frames each; the frame at rest comes last where there is one."""

    bend: Array  # (F,) 0 to 1, share of the largest bending
    after: Array  # (F,) 1 after the largest bending
    past: Array  # (F,) 0 to 1, share of the bending so far, summed over time
    resting: Array  # (F,) 1 for the frame at rest


def course(recording: FitData, now: Prediction) -> Course:
    """From the fitted shapes and the frames' times."""
    time = recording.observations.time[recording.frames]
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


def alternatives(recording: FitData, layout: Layout, x: Array, now: Prediction) -> list[Alternative]:
    """All that are tested on one film."""
    run, patterns = course(recording, now), mechanics(recording, layout, x, now)
    pliant = patterns["clamp"] * _clamp_moment(now.solved)[:, None, None, None]
    wanted = {name: patterns[name] for name in UNITS if name in patterns} | {"clamp gives": pliant}
    if layout.index["curvature", -1].start >= 0 or layout.index["rest change", recording.number].start >= 0:
        del wanted["rest shape"]
    along, stated = Suspect("mechanics", "stiffness along"), []
    otherwise = wanted.pop(along.name)
    if layout.known is not None:
        stated.append(Alternative(along, otherwise, layout.spline.nearest(_along)))
    for allowed, names in _ALLOWED.items():
        if any(a.name == allowed for a in recording.allowances):
            for name in names:
                wanted.pop(name, None)
    if recording.observations.static:  # poses have no order in time
        wanted.pop("viscous", None)
        return [*stated, *(Alternative(Suspect("mechanics", name), pattern) for name, pattern in wanted.items())]
    stiff = [Alternative(Suspect("mechanics", name), pattern) for name, pattern in wanted.items()]
    return [*stated, *stiff, *_changes(recording, run, patterns), *_trends(recording, run)]


def mechanics(recording: FitData, layout: Layout, x: Array, now: Prediction) -> dict[str, Array]:
    """(F, m, 3, n) per unit of what `UNITS` names, and of the clamp's angle ("clamp")."""
    carried, ride = _carried(recording, layout, x, now), tag_ride(recording, layout, x, now.solved)
    patterns = {}
    for name, part in place_responses(
        now.solved, _entering(recording, now), tag_places(recording, layout, x, now.solved)[0]
    ).items():
        if name in carried:
            part[:, :, :2] += carried[name][..., None]
        patterns[name] = ride.carry(part)
    return patterns


def _entering(recording: FitData, now: Prediction) -> dict[str, Perturbation]:
    """How the alternatives enter the balance of moments. With N = (N_u, N_n) along and across, `M' = -L N_n`.

    A stretch e = N_u / (E A) makes it -L (1 + e) N_n, a shear g = N_n / (G A) adds L g N_u (Reissner's beam).
    """
    solved, problem = now.solved, now.solved.problem
    u, n = _tangents(solved)
    force = problem.dead_force
    product = (np.sum(force * u, axis=-1) * np.sum(force * n, axis=-1))[..., None] * n
    pushed = recording.beyond[..., None] * now.force[:, None, :]
    turned = np.stack([-pushed[..., 1], pushed[..., 0]], axis=-1)
    along, across = along_and_across(now.force, solved.angle(recording.push_s[:, None])[:, 0])
    loaded = (np.arange(len(force)) < int(np.sum(recording.frames))).astype(float)
    sag = (loaded[:, None] * (1.0 - problem.grid.nodes))[..., None, None] * np.eye(2)
    return {
        "stretch": _force(product),
        "shear": _force(-product),
        "length": _force(force),
        "push place": push_moment(problem, recording.push_s, float(problem.length) * across),
        "push beside": push_moment(problem, recording.push_s, -along),
        "force direction": _force(turned),
        "axis scale": _force(pushed * np.array([1.0, -1.0])),
        "weight": Perturbation(sag, None, None, np.zeros(2)),
        "viscous": Perturbation(None, None, (_rate(recording, solved), np.ones((force.shape[1], 1))), np.zeros(1)),
        "clamp": of_clamp_angle(problem),
        "rest shape": of_rest_curvature(problem, REST_MODES.curvature(problem.grid.nodes)),
        "stiffness along": of_stiffness(solved, problem.k[..., None] * _along(problem.grid.nodes)),
    }


def _along(s: Array) -> Array:
    """(..., n) Legendre polynomials of s, the constant left out."""
    return np.asarray(np.polynomial.legendre.legvander(2.0 * s - 1.0, _ALONG)[..., 1:])


def _carried(recording: FitData, layout: Layout, x: Array, now: Prediction) -> dict[str, Array]:
    """(F, m, 2) m per unit that the tags move by without a turn of the beam: `r' = L (1 + e) u + L g n`."""
    solved, s = now.solved, tag_places(recording, layout, x, now.solved)[0]
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


def _changes(recording: FitData, run: Course, patterns: dict[str, Array]) -> list[Alternative]:
    """What may change in the course of one recording: by the bending so far, and after the largest one."""
    name = recording.observations.source.name
    frames, tags = patterns["clamp"].shape[:2]
    place = np.zeros((frames, tags, 3, 2))
    place[:, :, 0, 0] = place[:, :, 1, 1] = 1.0
    slip = np.concatenate([patterns["clamp"], place], axis=-1)
    out = [
        Alternative(Suspect("change", "creep", recording=name), _in_time(patterns["rest shape"], run)),
        Alternative(Suspect("change", "slip", recording=name), _in_time(slip, run)),
    ]
    for i, tag in enumerate(recording.observations.tag_id.tolist()):
        own = np.zeros((frames, tags, 3, 3))
        own[:, i] = np.eye(3)
        out.append(Alternative(Suspect("change", "loose", tag, name), _in_time(own, run)))
    return out


def _trends(recording: FitData, run: Course) -> list[Alternative]:
    """Every coordinate of every tag: smooth in the bending, apart on the way out and back, and in time."""
    side, tags = run.after - 0.5, recording.observations.tag_id.tolist()
    smooth = [run.bend, run.bend**2, run.bend * side, run.bend**2 * side, run.past]
    functions = np.stack(smooth, axis=1) * (1.0 - run.resting[:, None])
    out = []
    for i, tag in enumerate(tags):
        for c, axis in enumerate(AXES):
            pattern = np.zeros((len(run.bend), len(tags), 3, len(smooth)))
            pattern[:, i, c] = functions
            out.append(Alternative(Suspect("trend", axis, tag, recording.observations.source.name), pattern))
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


def _rate(recording: FitData, solved: Equilibrium) -> Array:
    """(F, Q) rad/s of the curvature; zero at rest."""
    time = recording.observations.time[recording.frames]
    out = np.zeros_like(solved.q)
    if len(time) > 1:
        out[: len(time)] = np.gradient(solved.q[: len(time)], time, axis=0)
    return out
