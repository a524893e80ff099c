"""The force on a learned beam while it is being pushed: a frame in, a force out.

A frame begins at the force and the shape of the one before: one or two Gauss-Newton steps, each an equilibrium from
near by. What the frames share is integrated out as it counts there: near a buckling load that changes much from frame
to frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.blas import one_blas_thread
from onebend.learning.design.instruments import Instruments
from onebend.learning.model.frames import whitening
from onebend.learning.sensing.bench import INNERMOST, Bench, problem_of, solve
from onebend.learning.sensing.estimate import PLACE_PRIOR
from onebend.learning.sensing.search import TOUCH, first
from onebend.learning.sensing.sense import bench_of, places_of, prior_of
from onebend.learning.sensing.sensed import SenseSettings
from onebend.learning.sensing.tags import Tags, tags_of
from onebend.records import Array, Observations

_STEPS = 8
_CLOSE = 0.3  # posterior sds: a step this small is the last, and taken to first order
_SLID = 0.02  # of s: a place so far from the grid's edge gets a grid of its own
_LOST = 20.0  # squared residuals over their count, above the usual: the search begins anew
_ONE = np.zeros(1, dtype=np.int64)


@dataclass(frozen=True)
class LiveForce:
    """The force in one frame, beam's frame; NaN where the frame tells nothing, or no force explains it: then `chi2` is
    more than twenty times the count of what was measured."""

    time: float  # s
    force: Array  # (2,) N
    covariance: Array  # (2, 2) N^2
    place: float  # s
    place_sd: float  # of s
    touched: bool  # zero force lies outside the 95 % region
    chi2: float  # squared residuals in units of all noise


@dataclass(frozen=True)
class _Shape:
    """The beam as it was solved last."""

    unknown: Array  # (d,) N, N, s
    edge: float  # s, of the grid
    tags: Tags
    noise: Array  # (m, 3, r) what the frames share, as it counts here


class OnlineSense:
    """Force (and place) of each frame as it comes.

    Stiffness and force together cannot be told without a force log: k(s) stays as it was learned.
    """

    def __init__(
        self,
        beam: Beam,
        at_rest: Observations,
        *,
        stiffness: UncertainStiffness | None = None,
        instruments: Instruments | None = None,
        settings: SenseSettings = SenseSettings(),
    ) -> None:
        """`at_rest`: what was seen of the beam with nothing on it, and what is stated of it.

        Raises:
            LearningError: as `sense`.
        """
        o = replace(at_rest, source=replace(at_rest.source, view=None), by_camera=None)
        self._bench = bench_of(beam, o, stiffness, instruments, settings)
        every = np.arange(len(o.time), dtype=np.int64)
        self._place = None if settings.place == "unknown" else float(places_of(o, every, settings)[0])
        self._sd = np.array([prior_of(beam, settings)] * 2 + [PLACE_PRIOR[1]])
        self._mean = np.array([0.0, 0.0, PLACE_PRIOR[0]])
        if self._place is not None:
            self._sd, self._mean = self._sd[:2], self._mean[:2]
        self._shape: _Shape | None = None

    @one_blas_thread
    def add(self, time: float, xy: Array, angle: Array, covariance: Array) -> LiveForce:
        """The force in a frame at `time` [s]: tags at `xy` (m, 2) [m], `angle` (m,) [rad], with their covariance
        (m, 3, 3); NaN where a tag was not seen."""
        seen = np.concatenate([xy, angle[:, None]], axis=1)
        if np.sum(np.isfinite(xy)) < 2:
            none = np.full((2, 2), np.nan)
            return LiveForce(time, none[0], none, np.nan, np.nan, False, np.nan)
        whiten = whitening(seen, covariance)
        count = int(np.sum(np.isfinite(seen)))
        shape = self._shape if self._shape is not None else self._anew(time, seen, covariance)
        found = self._follow(shape, seen, whiten)
        if found is None or found[3] > _LOST * count:
            again = self._follow(self._anew(time, seen, covariance), seen, whiten)
            found = again if found is None or (again is not None and again[3] < found[3]) else found
        if found is None or not found[3] <= _LOST * count:
            self._shape, none = None, np.full((2, 2), np.nan)
            return LiveForce(time, none[0], none, np.nan, np.nan, False, np.nan if found is None else found[3])
        self._shape, unknown, spread, chi2 = found
        axes = self._bench.axes
        force, part = axes @ unknown[:2], axes @ spread[:2, :2] @ axes.T
        if self._place is None:
            place, place_sd = float(unknown[2]), float(np.sqrt(spread[2, 2]))
        else:
            place, place_sd = self._place, self._bench.place_sd / self._bench.observations.length
        touched = bool(force @ np.linalg.solve(part, force) > TOUCH)
        return LiveForce(time, force, part, place, place_sd, touched, chi2)

    def _follow(self, shape: _Shape, seen: Array, whiten: Array) -> tuple[_Shape, Array, Array, float] | None:
        """Shape, unknowns (d,), their covariance and the squared residuals; None where the beam does not stand."""
        for number in range(_STEPS):
            slopes, residual = self._whitened(shape, seen, whiten)
            left, told, turn = np.linalg.svd(slopes, full_matrices=False)
            z = (shape.unknown - self._mean) / self._sd
            step = turn.T @ ((told * (left.T @ residual) - turn @ z) / (1.0 + told**2))
            unknown = shape.unknown + self._sd * step
            if self._place is None:
                unknown[2] = np.clip(unknown[2], INNERMOST, 1.0)
            moved = np.linalg.norm(np.hypot(1.0, told) * (turn @ step))
            if number and moved < _CLOSE:
                break
            now = self._solved(unknown, shape)
            if now is None:
                return None
            shape = now
        slopes, residual = self._whitened(shape, seen, whiten)
        _, told, turn = np.linalg.svd(slopes, full_matrices=False)
        root = self._sd[:, None] * turn.T / np.hypot(1.0, told)
        left_over = residual - slopes @ ((unknown - shape.unknown) / self._sd)
        return shape, unknown, root @ root.T, float(left_over @ left_over)

    def _whitened(self, shape: _Shape, seen: Array, whiten: Array) -> tuple[Array, Array]:
        """(3 m, d) slopes over the priors' sds, and (3 m,) residuals, in units of all noise."""
        tags, count = shape.tags, seen.size
        shared = (whiten @ shape.noise).reshape(count, -1)
        own = tags.by_load[0]
        if self._place is None:
            own = np.concatenate([own, self._bench.observations.length * tags.by_place[0]], axis=-1)
        both = np.concatenate([own * self._sd, np.nan_to_num(seen - tags.pose[0])[..., None]], axis=-1)
        root = np.linalg.cholesky(np.eye(count) + shared @ shared.T)
        out = np.linalg.solve(root, (whiten @ both).reshape(count, -1))
        return out[:, :-1], out[:, -1]

    def _solved(self, unknown: Array, near: _Shape) -> _Shape | None:
        edge = near.edge
        if self._place is None and abs(unknown[2] - edge) > _SLID:
            edge = float(unknown[2])
        bench, at = self._at(unknown, edge)
        problem = problem_of(bench, _ONE, at)
        q = near.tags.solved.q
        start = q if q.shape[1] == problem.grid.nodes.shape[-1] else None
        solved = solve(bench, problem, unknown[None, :2], at, start)
        if start is not None and not solved.converged[0]:
            solved = solve(bench, problem, unknown[None, :2], at, None)
        if not solved.converged[0]:
            return None
        tags = tags_of(bench, _ONE, solved, unknown[None, :2], at)
        return _Shape(unknown, edge, tags, tags.by_shared[0] @ bench.root)

    def _at(self, unknown: Array, edge: float) -> tuple[Bench, Array]:
        """The bench with the place that is sought as far from the grid's edge as it is, and that edge."""
        if self._place is not None:
            return self._bench, np.array([self._place])
        mean = self._bench.mean.copy()
        mean[self._bench.parts["place"]] = (unknown[2] - edge) * self._bench.observations.length
        return replace(self._bench, mean=mean), np.array([edge])

    def _anew(self, time: float, seen: Array, covariance: Array) -> _Shape:
        """As a recording's frame is sought that has none before it."""
        o = self._bench.observations
        alone = replace(
            o,
            time=np.array([time]),
            frame=_ONE,
            xy=seen[None, :, :2],
            angle=seen[None, :, 2],
            covariance=covariance[None],
            force=np.zeros((1, 2)),
            push_s=np.full(1, np.nan),
            loaded=np.ones(1, dtype=bool),
            gravity=o.gravity[:1],
        )
        bench = replace(self._bench, observations=alone)
        place = None if self._place is None else np.array([self._place])
        found, _ = first(bench, _ONE, place, self._sd[:2])
        unknown = np.append(np.nan_to_num(found.force[0]), found.place[0])[: len(self._sd)]
        edge = self._place if self._place is not None else float(found.place[0])
        here, at = self._at(unknown, edge)
        solved = solve(here, problem_of(here, _ONE, at), unknown[None, :2], at, None)
        tags = tags_of(here, _ONE, solved, unknown[None, :2], at)
        return _Shape(unknown, edge, tags, tags.by_shared[0] @ here.root)
