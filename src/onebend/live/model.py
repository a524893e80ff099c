"""What stays the same while one beam is filmed live: its parameters, and the beam on grids for the places of the push;
key frames, linearised by the model of the fit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from onebend.beam.continuation import ContinuationSettings
from onebend.beam.problem import Resolution
from onebend.beam.setup import MOST_REACHED
from onebend.learning import allowances as effects, parameters
from onebend.learning.fit_data import FitData, fit_data
from onebend.learning.force_error import SpannedError
from onebend.learning.linear import FitProblem, Hyperparameters
from onebend.learning.prediction import predict
from onebend.learning.sites import is_shaped
from onebend.live.key_frames import FrameTerms, KeyFrames, course_of_frame, course_scale
from onebend.records import Array, BoolArray, Observations, Source, Stated, tags_among

RESOLUTION = Resolution(order=12, widest=0.5)  # coarser than the fit's, for time's sake
MOST_NODES = 3 * RESOLUTION.order  # of a push anywhere
_NEAR = ContinuationSettings(last=1e-3)  # rad: the error is about its square
_STILL = ("log k", "section", "length")  # where allowances enter that do not go with the frames
_GRIDS = 50  # over the length; a push between two places acts along the tangent from the nearer one
# Parts of the curvature that those which lag behind it (`TIMES`) are taken to reach: on the way k is the secant
# stiffness of such a push.
REACHED = np.array([0.8, 0.5, 0.25])


@dataclass(frozen=True, eq=False)
class LiveSession:
    """The beam, its tags and its parameters. Sessions are equal only to themselves."""

    observations: Observations  # beam and tags as stated, in one frame that shows nothing
    layout: parameters.Layout
    course: effects.PushCourse  # of one frame
    allowances: tuple[effects.Allowance, ...] = ()  # with their bases in one frame, where they have some

    @property
    def length(self) -> float:
        """m."""
        return self.observations.length

    @cached_property
    def terms(self) -> FrameTerms:
        """The allowances that go with the frames."""
        enter = ("force", "place", "clamp", "poses")
        return FrameTerms(tuple(a for a in self.allowances if a.enters in enter and a.name in self.columns))

    @property
    def columns(self) -> dict[str, slice]:
        """Columns of all blocks of parameters that are not frozen, by their names."""
        return self.layout.free_columns(0)

    def other_sd(self, largest: float, bend: float) -> Array:
        """(n - p,) prior sds of all parameters but log k's coefficients, as the push so far has it (`course_scale`)."""
        own = {a.name: course_scale(a, largest, bend) for a in self.allowances}
        blocks = [b for b in self.layout.blocks if b.start > 0]
        return np.concatenate([np.zeros(0), *(b.prior_sd * own.get(b.name, 1.0) for b in blocks)])

    @cached_property
    def bounded(self) -> tuple[parameters.Block, ...]:
        """The blocks whose priors are not normal."""
        return tuple(b for b in self.layout.blocks if is_shaped(b))

    @cached_property
    def patches_on_finer(self) -> Array:
        """(f, n) coefficients, of the finer spline, of the functions of log k under the tags; n = 0 without them."""
        fine, o = self.layout.spline.finer, self.observations
        if "patches" not in self.columns:
            return np.zeros((fine.count, 0))
        tags = o.marker_s[tags_among(o)]
        return fine.nearest(lambda s: effects.patch_functions(tags, o.length, o.stated.tag_size, s))


@dataclass(frozen=True)
class FrameInputs:
    """What acts on the beam in B frames."""

    force: Array  # (B, 2) N, corrected
    rate: Array  # (B, 2) N/s
    gravity: Array  # (B, 2) m/s^2
    farther: Array  # (B,) m that the push lies beyond its grid's place
    terms: Array  # (B, terms) of the allowances that go with the frames
    memory: effects.MaterialMemory


def session_of(
    spline: parameters.Spline,
    marker_s: Array,
    sds: Mapping[str, float],
    *,
    traced: BoolArray | None = None,
    length: float,
    mass: float,
    allowances: frozenset[str] = frozenset(),
    thickness: float = math.nan,
    tag_size: float = math.nan,
) -> LiveSession:
    """One beam under one camera; the force's error is a process and not among the parameters. `traced` as of
    `course_of_frame`.

    `sds`: of `STATED_ERRORS` by name, else as usual; without "scale" the camera is calibrated, and without "clock"
    camera and force log share one clock. Allowances that are not wanted are frozen.
    """
    course = course_of_frame(marker_s, length, tag_size, thick=bool(np.isfinite(thickness)), traced=traced)
    wanted: list[effects.Allowance] = []
    for one in parameters.STATED_ERRORS:
        sd: float | Array = sds.get(one.name, one.usual)
        if one.name == "mass":
            sd = np.append(sd if mass > 0.0 else 0.0, np.full(3, parameters.MASS_SPREAD))
        wanted.append(one.with_sd(sd, course.tags))
    every = effects.allowances_of(course, effects.LIVE_ALLOWANCES)
    wanted += [replace(a, prior_sd=a.prior_sd * (a.name in allowances)) for a in every]
    # All priors but the section's are normal, for time's sake.
    wanted = [replace(a, sizes=(1.0,), within=a.within if a.name == "section" else effects.ANYTHING) for a in wanted]
    wanted += parameters.without_recording()
    layout = parameters.layout_of(
        spline, [(-1, a) for a in wanted if a.shared] + [(0, a) for a in wanted if not a.shared]
    )
    m, missing = len(marker_s), np.full((1, len(marker_s), 3), np.nan)
    stated = Stated("unknown", mass, 0.0, mass_along="even", thickness=thickness, tag_size=tag_size)
    shown = Observations(
        source=Source(""),
        stated=stated,
        length=length,
        time=np.zeros(1),
        frame=np.zeros(1, dtype=np.int64),
        tag_id=np.arange(1, m + 1),
        marker_s=marker_s,
        xy=missing[..., :2],
        angle=missing[..., 2],
        covariance=np.zeros((1, m, 3, 3)),
        force=np.zeros((1, 2)),
        force_sd=np.zeros(2),
        push_s=np.ones(1),
        loaded=np.ones(1, dtype=bool),
        rest_xy=missing[0, :, :2],
        rest_angle=missing[0, :, 2],
        rest_covariance=np.zeros((m, 3, 3)),
        gravity=np.array([[0.0, -1.0 if mass > 0.0 else 0.0]]),
        traced=traced,
    )
    return LiveSession(shown, layout, course, every)


def nearest_grid_place(push_s: float) -> float:
    """The place nearest to a push at which there is a grid."""
    return max(round(push_s * _GRIDS), 1) / _GRIDS


@lru_cache(maxsize=4 * _GRIDS)
def pushed_at(session: LiveSession, push_s: float) -> FitData:
    """One frame under a push at `push_s`, as the fit has it."""
    o = replace(session.observations, push_s=np.array([push_s]))
    data = fit_data(o, 0, np.ones(1, dtype=bool), session.layout.spline, resolution=RESOLUTION)
    still = {a.name: a for a in session.allowances if a.name in session.columns and a.enters in _STILL}
    if "patches" in still:
        under_tags = effects.patch_means(o.marker_s[data.tags], o.length, o.stated.tag_size, data.problem.grid)
        still["patches"] = replace(still["patches"], basis=under_tags)
    return replace(data, allowances=tuple(still.values()))


def problem_of(
    session: LiveSession,
    error: SpannedError,
    start: tuple[float, tuple[Array, Array] | None],
    expected: Hyperparameters,
) -> FitProblem:
    """The key frames as a recording of the fit, of log k and this force error; `start`: `level` and `stiffness` of the
    problem."""
    data = replace(pushed_at(session, 1.0), error=error)
    layout = _layout_of(session.layout.spline, len(error.knots))
    return FitProblem((data,), layout, start[0], expected, stiffness=start[1])


@lru_cache(maxsize=2 * _GRIDS)
def _layout_of(spline: parameters.Spline, errors: int) -> parameters.Layout:
    """log k and so many force errors."""
    return parameters.layout_of(spline, [(0, parameters.inside("force", "N", 1.0, ("",) * 2 * errors))])


def frames_at(session: LiveSession, push_s: float, inputs: FrameInputs) -> FitData:
    """B frames under pushes near `push_s`, as the fit has them: what the beam remembers is given."""
    one, count = pushed_at(session, push_s), len(inputs.force)
    return replace(
        one,
        force=inputs.force,
        rate=inputs.rate,
        error_weights=np.zeros((count, 0)),
        problem=replace(one.problem, moment=np.zeros((count, one.farther.shape[1]))),
        beyond=one.beyond + inputs.farther[:, None] * one.farther,
        mass=replace(one.mass, gravity=inputs.gravity) if one.mass is not None and np.any(inputs.gravity) else None,
        allowances=(*one.allowances, *session.terms.with_terms(inputs.terms)),
        memory=inputs.memory if "relaxation" in session.columns else None,
    )


# Linearises key frames through the equilibrium, those that share a grid together.


class Lineariser:
    """Linearises key frames at parameters."""

    def __init__(self, session: LiveSession) -> None:
        self._session = session
        self._pushed = 1.0  # place of the last push
        for i in range(1, _GRIDS + 1):  # beforehand, so that a new place costs no time
            pushed_at(session, i / _GRIDS)

    def pushed_at(self, push_s: float) -> None:
        """Take note of the place of the push."""
        self._pushed = nearest_grid_place(push_s)

    def renew(self, keys: KeyFrames, chosen: list[int], point: Array) -> set[int]:
        """Linearise key frames at parameters `point` (n,); returns those with an equilibrium there. The others stay."""
        solved: set[int] = set()
        grids = [self._grid_of(keys, i) for i in chosen]
        for push_s in dict.fromkeys(grids):
            part = [i for i, grid in zip(chosen, grids, strict=True) if grid == push_s]
            solved |= self._renew(keys, push_s, point, part)
        return solved

    def _renew(self, keys: KeyFrames, push_s: float, point: Array, chosen: list[int]) -> set[int]:
        session, loaded, here = self._session, ~keys.rest[chosen], self._on_grid(keys, push_s, chosen)
        force = (keys.force[chosen] - keys.error[chosen]) * loaded[:, None]
        beyond = session.length * (keys.push_s[chosen] - push_s) * loaded
        inputs = FrameInputs(
            force,
            keys.rate[chosen] * loaded[:, None],
            keys.gravity[chosen],
            beyond,
            keys.terms[chosen],
            self._memory(keys, push_s, (chosen, here), point),
        )
        now = predict(frames_at(session, push_s, inputs), session.layout, point, here[..., 0], settings=_NEAR)
        found, slopes = now.solved.converged & now.solved.stable, now.slopes
        good = slice(None) if found.all() else found
        solved, q = np.asarray(chosen)[good], now.solved.q
        if len(solved) == 0:
            return set()
        shapes = np.concatenate([q[..., None], inputs.memory.lags(now.bending)], axis=2)
        keys.shape[solved, : q.shape[1]] = shapes[good]
        keys.grid[solved] = push_s
        keys.set_linear(solved, point, now.pose[good], slopes.j[good], (slopes.a @ slopes.axes)[good])
        return set(solved.tolist())

    def _memory(
        self, keys: KeyFrames, push_s: float, frames: tuple[list[int], Array], point: Array
    ) -> effects.MaterialMemory:
        """Memory of the beam in the chosen frames, from the key frame before each; `frames`: these, and their shapes.
        What bends the beam as the push begins has done so for long; a later first one and proposed averages keep
        theirs."""
        chosen, here = frames
        before, now = here[..., 1:], np.zeros((len(chosen), len(effects.TIMES)))
        if "relaxation" not in self._session.columns:
            return effects.MaterialMemory(np.zeros_like(before), now, REACHED)
        rest_on_nodes, curvature = pushed_at(self._session, push_s).rest_on_nodes, self._curvature(point)
        bending = here[..., :1] - (rest_on_nodes @ curvature)[:, None]
        centre = 0.5 * (keys.begin + keys.end)
        kept, entered, last = (w.T for w in effects.lag_weights(np.diff(centre)))
        place = {k: b for b, k in enumerate(chosen)}
        if keys.begun and 0 in place:
            before[place[0]], now[place[0]] = 0.0, 1.0
        for k in sorted(chosen):
            if not 0 < k < keys.used:
                continue
            b, b0 = place[k], place.get(k - 1)
            if b0 is None:
                other = self._on_grid(keys, push_s, [k - 1])[0]
                lags, bent = other[:, 1:], other[:, :1] - (here[b, :, :1] - bending[b])
            else:
                lags, bent = before[b0] + now[b0] * bending[b0], bending[b0]
            now[b] = last[k - 1]
            before[b] = kept[k - 1] * lags + entered[k - 1] * bent
        return effects.MaterialMemory(before, now, REACHED)

    def secant(self, keys: KeyFrames, point: Array, x: Array, covariance: Array) -> tuple[Array, Array]:
        """Mean (n,) and covariance (n, n) of the parameters, log k being made that of the secant stiffness of the push
        so far, `k_i (1 - c)`."""
        if "relaxation" not in self._session.columns:
            return x, covariance
        layout, reached = self._session.layout, self._reached(keys, point)
        where, p, shares = layout.index["relaxation", -1].where, layout.spline.count, layout.get(x, "relaxation")
        left, usual = (1.0 - min(float(shares @ part), MOST_REACHED) for part in (reached, REACHED))
        out, onto = x.copy(), np.eye(len(x))
        out[:p] += np.log(left / usual)
        onto[:p, where] = REACHED / usual - reached / left
        return out, onto @ covariance @ onto.T

    def _reached(self, keys: KeyFrames, point: Array) -> Array:
        """(r,) parts of the curvature that those which lag behind it have reached over the frames in use."""
        curvature, lagged, square = self._curvature(point), np.zeros(len(effects.TIMES)), 0.0
        for i in range(keys.used):
            if keys.grid[i] != 0.0 and not keys.rest[i]:
                data = pushed_at(self._session, float(keys.grid[i]))
                q = keys.q[i, : len(data.rest_on_nodes)] - data.rest_on_nodes @ curvature
                here = data.problem.weights * keys.frames[i] * q
                lagged, square = lagged + here @ keys.lags[i, : len(q)], square + float(here @ q)
        return lagged / square if square > 0.0 else REACHED

    def _curvature(self, point: Array) -> Array:
        """(3,) rad, states of the beam at rest."""
        return self._session.layout.get(point, "curvature")

    def _on_grid(self, keys: KeyFrames, push_s: float, chosen: list[int]) -> Array:
        """(B, Q, 1 + r) shapes of key frames, interpolated where they are on another grid."""
        nodes = pushed_at(self._session, push_s).problem.grid.nodes
        out, grids = keys.shape[chosen, : len(nodes)], keys.grid[chosen].tolist()
        for row, i, grid in zip(out, chosen, grids, strict=True):
            if grid not in (push_s, 0.0):
                before = pushed_at(self._session, grid).problem.grid.nodes
                for c in range(out.shape[-1]):
                    row[:, c] = np.interp(nodes, before, keys.shape[i, : len(before), c])
        return out

    def _grid_of(self, keys: KeyFrames, i: int) -> float:
        """Place of the push on the grid of key frame i; at rest any grid will do, and the last one is taken."""
        return self._pushed if keys.rest[i] else nearest_grid_place(float(keys.push_s[i]))
