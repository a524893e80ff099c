"""The force of each frame: maximum a posteriori by Gauss-Newton, many frames at once.

Residuals r of a frame, whitened by the tags' noise and by what frames share (`model.py`), and their derivatives J with
its own unknowns u, in units of their priors' sds, give damped steps `(1 + d) (J^T J + I) du = J^T r - u`. The
covariance is `(J^T J + I)^-1`. What frames share counts as at the start of a search; a second search begins where the
first ended.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from onebend.beam.grid import apply
from onebend.beam.statics import Equilibrium
from onebend.learning.frames import moved_by, whitening
from onebend.learning.sensing import model
from onebend.learning.sensing.model import AT_REST, INNERMOST, Bench, Tags
from onebend.records import Array, BoolArray, IntArray

CHUNK = 250  # frames solved together
_STEPS = 40
_STRIDE = 1.5  # of k/L: no longer step of the force at once
_FAR = 3.0  # times what is usual
_LAST = 3e-3  # posterior sds: after a step this small a further one is not worth its cost: it is its square
_SEARCHES = 2
_HALVINGS = 6  # of a first force under which the beam does not stand
_MOST_DAMPING = 1e8  # damping: no step is left that lowers anything
PLACE_PRIOR = (0.5, 0.29)  # mean and sd of a place of which nothing is known: those of an even spread over the beam


def with_place(prior_sd: Array, seek_place: bool) -> tuple[Array, Array]:
    """(d,) sds and means of a frame's unknowns, of a load with `prior_sd` (n,) and, where it is sought, its place."""
    mean = np.zeros(len(prior_sd))
    if not seek_place:
        return prior_sd, mean
    return np.append(prior_sd, PLACE_PRIOR[1]), np.append(mean, PLACE_PRIOR[0])


@dataclass(frozen=True)
class Estimates:
    """Forces of F frames. NaN where none was found."""

    force: Array  # (F, n) N, the load (`model.py`)
    place: Array  # (F,) s
    covariance: Array  # (F, d, d) of load and, where it was sought, place: N, N m, s
    common: Array  # (F, n, r) N, effect on the load of one sd of each error of the bench
    objective: Array  # (F,) squared residuals, whitened, and the prior's part
    chi2: Array  # (F,) squared residuals, whitened
    pose: Array  # (F, m, 3) the tags that belong to it

    def take(self, rows: IntArray | BoolArray) -> Estimates:
        return Estimates(*(values[rows] for values in vars(self).values()))

    def then(self, other: Estimates) -> Estimates:
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Estimates(*(np.concatenate(pair) for pair in pairs))


@dataclass
class _SearchState:
    """Where the search of F frames stands."""

    unknown: Array  # (F, d)
    q: Array  # (F, Q)
    stands: BoolArray  # (F,) an equilibrium was found
    pose: Array  # (F, m, 3)
    root: Array  # (F, 3 m, 3 m): applied to residuals over the tags' noise
    residual: Array  # (F, 3 m) in units of all noise
    slopes: Array  # (F, 3 m, d) of the same with the unknowns over their priors' sd
    shared: Array  # (F, 3 m, r) of the same with what the frames share; none while a search goes on

    def put(self, rows: IntArray, other: _SearchState) -> None:
        """These rows as in `other`."""
        for name, values in vars(self).items():
            if name != "shared":
                values[rows] = getattr(other, name)


class FrameModel:
    """Some frames and their unknowns: the load of each and, where it is sought, its place."""

    def __init__(self, bench: Bench, frames: IntArray, place: Array, prior_sd: Array, seek_place: bool) -> None:
        o = bench.observations
        self.bench, self.frames, self.place, self.seek_place = bench, frames, place, seek_place
        self.seen = np.concatenate([o.xy[frames], o.angle[frames][..., None]], axis=-1)
        self.whiten = whitening(self.seen, o.covariance[frames])
        self.sd, self.mean = with_place(prior_sd, seek_place)
        self.load = len(prior_sd)

    def flat(self, of_tags: Array, rows: IntArray | slice = slice(None)) -> Array:
        """(F, 3 m, n) of (F, m, 3, n), over the tags' noise."""
        return np.asarray((self.whiten[rows] @ of_tags).reshape(len(of_tags), -1, of_tags.shape[-1]))

    def away(self, pose: Array, rows: IntArray | slice = slice(None)) -> Array:
        """(F, 3 m) of the tags from poses (F, m, 3), over their noise."""
        return self.flat(np.nan_to_num(self.seen[rows] - pose)[..., None], rows)[..., 0]

    def own_slopes(self, tags: Tags, rows: IntArray | slice = slice(None)) -> Array:
        """(F, 3 m, d) of the tags with the frames' own unknowns over their priors' sds, over the tags' noise."""
        own = tags.by_load
        if self.seek_place:
            own = np.concatenate([own, self.bench.observations.length * tags.by_place], axis=-1)
        return self.flat(own * self.sd, rows)

    def inside(self, unknown: Array) -> Array:
        """The unknowns (F, d), with places on the beam."""
        if not self.seek_place:
            return unknown
        return np.column_stack([unknown[:, :-1], np.clip(unknown[:, -1], INNERMOST, 1.0)])

    def placed(self, unknown: Array, rows: IntArray | slice = slice(None)) -> Array:
        """(F,) places of the loads."""
        return unknown[:, -1] if self.seek_place else self.place[rows]

    def costs(self, residual: Array, unknown: Array) -> Array:
        """(F,) squared residuals (F, R), and the prior's part."""
        return np.asarray(np.sum(residual**2, axis=1) + np.sum(((unknown - self.mean) / self.sd) ** 2, axis=1))


def estimate(
    bench: Bench,
    frames: IntArray,
    place: Array,
    prior_sd: Array,
    *,
    seek_place: bool,
    force: Array | None = None,
    restarts: int = 4,
) -> Estimates:
    """The force in `frames` (F,), rising, from `force` (F, 2) N (default: that of `begin`) at `place` (F,), which is
    where it acts or, with `seek_place`, where the search begins. `prior_sd` (n,): of
    each number of the load, mean zero."""
    first = model.first_forces(bench, frames, place, prior_sd) if force is None else force
    found = _searched(bench, frames, place, prior_sd, seek_place, first)
    for _ in range(restarts):  # frames that ended far from what their neighbours explain begin anew where those ended
        numbers = np.sum(np.isfinite(bench.observations.xy[frames]), axis=(1, 2))
        lost = np.flatnonzero(~(found.objective < _FAR * np.maximum(numbers, np.nanmedian(found.objective))))
        good = np.setdiff1d(np.arange(len(frames)), lost)
        if not (lost.size and good.size):
            break
        near = good[np.argmin(np.abs(good - lost[:, None]), axis=1)]
        at = found.place[near] if seek_place else place[lost]
        again = _searched(bench, frames[lost], at, prior_sd, seek_place, found.force[near])
        better = np.flatnonzero(again.objective < found.objective[lost])
        if not better.size:
            break
        for name, values in vars(found).items():
            values[lost[better]] = getattr(again, name)[better]
    return found


def _searched(
    bench: Bench, frames: IntArray, place: Array, prior_sd: Array, seek_place: bool, force: Array
) -> Estimates:
    parts = [
        _Search(bench, frames[i : i + CHUNK], place[i : i + CHUNK], prior_sd, seek_place).run(force[i : i + CHUNK])
        for i in range(0, len(frames), CHUNK)
    ]
    return Estimates(*(np.concatenate(each) for each in zip(*(vars(one).values() for one in parts), strict=True)))


class _Search(FrameModel):
    """Gauss-Newton for one chunk of frames."""

    def __init__(self, bench: Bench, frames: IntArray, place: Array, prior_sd: Array, seek_place: bool) -> None:
        super().__init__(bench, frames, place, prior_sd, seek_place)
        self.problem = model.problem_of(bench, frames, place)
        stiff = _STRIDE * float(np.mean(self.problem.k))
        self.longest = np.full(len(self.sd), stiff / bench.observations.length)
        self.longest[2 : self.load] = stiff
        if seek_place:
            self.longest[-1] = np.inf

    def run(self, force: Array) -> Estimates:
        """From `force` (F, 2)."""
        unknown = np.column_stack([force, self.place]) if self.seek_place else force.copy()
        rows = np.arange(len(unknown))
        solved = self._solved(rows, unknown, None)
        for _ in range(_HALVINGS):
            if solved.converged.all():
                break
            unknown[~solved.converged, : self.load] *= 0.5
            solved = self._solved(rows, unknown, None)
        state = self._state(rows, unknown, solved, None)
        for _ in range(_SEARCHES - 1):
            self._search(state)
            state = self._state(rows, state.unknown, self._at(rows, state), None)
        self._search(state)
        return self._estimates(self._state(rows, state.unknown, self._at(rows, state), None))

    def _search(self, state: _SearchState) -> None:
        rows, damping = np.flatnonzero(state.stands), np.full(len(state.q), 1e-6)
        for _ in range(_STEPS):
            if not rows.size:
                break
            step, size = self._step(state, rows, damping[rows])
            trial = self.inside(state.unknown[rows] + step)
            there = self._solved(rows, trial, state.q[rows])
            pose = model.poses_of(self.bench, self.frames[rows], there)[0]
            away = apply(state.root[rows], self.away(pose, rows))
            lower = self.costs(away, trial) < self.costs(state.residual[rows], state.unknown[rows])
            better = np.flatnonzero(there.converged & lower)
            if better.size:
                there = there.take(better)
                state.put(rows[better], self._state(rows[better], trial[better], there, state.root[rows[better]]))
            won = np.isin(np.arange(len(rows)), better)
            damping[rows] = np.where(won, np.maximum(damping[rows] / 30.0, 1e-12), 10.0 * damping[rows])
            done = (size < _LAST) | (damping[rows] > _MOST_DAMPING)
            rows = rows[~done]

    def _at(self, rows: IntArray, state: _SearchState) -> Equilibrium:
        found = self._solved(rows, state.unknown, state.q)
        return replace(found, converged=found.converged & state.stands)

    def _estimates(self, state: _SearchState) -> Estimates:
        _, size, turn = np.linalg.svd(state.slopes, full_matrices=False)
        root = np.swapaxes(turn, 1, 2) / np.sqrt(1.0 + size[:, None] ** 2)
        covariance = self.sd[:, None] * (root @ np.swapaxes(root, 1, 2)) * self.sd
        known = np.where(state.stands[:, None], state.unknown, np.nan)
        place = known[:, -1] if self.seek_place else np.where(state.stands, self.place, np.nan)
        objective = np.where(state.stands, self.costs(state.residual, state.unknown), np.inf)
        chi2 = np.sum(state.residual**2, axis=1)
        gain = self.sd[:, None] * (root @ np.swapaxes(state.slopes @ root, 1, 2))
        common = -(gain @ state.shared)[:, : self.load]
        return Estimates(known[:, : self.load], place, covariance, common, objective, chi2, state.pose)

    def _solved(self, rows: IntArray, unknown: Array, start: Array | None) -> Equilibrium:
        """The beam in frames `rows` of the chunk."""
        place, problem = self.placed(unknown, rows), self.problem
        problem = model.problem_apart(self.bench, self.frames[rows], place) if self.seek_place else problem.take(rows)
        return model.solve(self.bench, problem, unknown[:, : self.load], place, start)

    def _state(self, rows: IntArray, unknown: Array, solved: Equilibrium, root: Array | None) -> _SearchState:
        """Whitened by the tags' noise and what the frames share, as it is here, or by the `root` (F, 3 m, 3 m)."""
        place = self.placed(unknown, rows)
        tags = model.tags_of(self.bench, self.frames[rows], solved, unknown[:, : self.load], place, shared=root is None)
        stands = solved.converged[:, None, None]
        shared = np.zeros((len(rows), 3 * self.seen.shape[1], 0))
        if root is None:
            shared = np.nan_to_num(np.where(stands, self.flat(tags.by_shared @ self.bench.root, rows), 0.0))
            size, ways = np.linalg.eigh(shared @ np.swapaxes(shared, 1, 2))
            root = (ways / np.sqrt(1.0 + np.maximum(size, 0.0))[:, None]) @ np.swapaxes(ways, 1, 2)
        slopes = root @ np.where(stands, self.own_slopes(tags, rows), 0.0)
        residual = apply(root, self.away(tags.pose, rows))
        return _SearchState(
            unknown.copy(), solved.q, solved.converged, tags.pose, root, residual, slopes, root @ shared
        )

    def _step(self, state: _SearchState, rows: IntArray, damping: Array) -> tuple[Array, Array]:
        """The step (F, d) of some frames, and its size in posterior sds."""
        slopes, z = state.slopes[rows], (state.unknown[rows] - self.mean) / self.sd
        left, size, turn = np.linalg.svd(slopes, full_matrices=False)
        right = size * np.einsum("frd,fr->fd", left, state.residual[rows]) - np.einsum("fed,fd->fe", turn, z)
        step = right / ((1.0 + size**2) * (1.0 + damping[:, None]))
        size = np.sqrt(np.sum((1.0 + size**2) * step**2, axis=1))
        step = np.einsum("fed,fe->fd", turn, step)
        step = step * self.sd
        longest = np.maximum(np.max(np.abs(step / self.longest), axis=1), 1.0)
        return step / longest[:, None], np.where(longest > 1.0, np.inf, size)


# Information of each frame on its force, to first order: `told = weigh f + common e + n`, with e (normal, of sd one)
# the errors that frames share and n the frame's own noise of sd one. The prior of the force is not in it.

_LONGEST = 0.25  # of the frames: so far apart noise is compared
_ALIKE = 0.05  # correlation of the noise below which it is none
_TOLD = 1e-3  # of the prior's sd over that of a frame: what tells less tells nothing
_FEWEST = 12  # frames from which the noise's memory is looked for


@dataclass(frozen=True)
class FrameForces:
    """Of F frames, rising in time; a frame that tells nothing has rows of zeros. The first row tells most."""

    time: Array  # (F,) s
    weigh: Array  # (F, 2, 2) 1/N
    told: Array  # (F, 2)
    common: Array  # (F, 2, r)
    widened: float  # of the variance of the frames' own noise, for its memory

    def take(self, rows: IntArray | slice) -> FrameForces:
        return FrameForces(self.time[rows], self.weigh[rows], self.told[rows], self.common[rows], self.widened)


@dataclass(frozen=True)
class _Linear:
    """Residuals over the tags' noise and their derivatives; zero where nothing was measured."""

    residual: Array  # (F, 3 m)
    by_force: Array  # (F, 3 m, 2) 1/N
    by_other: Array  # (F, 3 m, k) of the frame's other unknowns, over their priors' sds
    other: Array  # (F, k) less their priors' means, over their sds
    by_shared: Array  # (F, 3 m, r)
    measured: BoolArray  # (F, 3 m)


def read(
    bench: Bench, frames: IntArray, load: Array, place: Array, prior_sd: Array, *, seek_place: bool
) -> FrameForces:
    """Of `frames` (F,), to first order about `load` (F, n) at `place` (F,), NaN in frames that tell nothing; the
    frame's other unknowns are integrated out.

    Directions with less information than the prior (`prior_sd` (n,)) are left out: to first order they are not known.
    """
    known = np.flatnonzero(np.isfinite(load).all(axis=1))
    chunks = [known[i : i + CHUNK] for i in range(0, len(known), CHUNK)]
    parts = [_linear(bench, frames[rows], load[rows], place[rows], prior_sd, seek_place) for rows in chunks]
    count, ways, time = len(frames), bench.root.shape[1], bench.observations.time[frames]
    weigh, told, common = np.zeros((count, 2, 2)), np.zeros((count, 2)), np.zeros((count, 2, ways))
    if not parts:
        return FrameForces(time, weigh, told, common, 1.0)
    one = _Linear(*(np.concatenate(each) for each in zip(*(vars(part).values() for part in parts), strict=True)))
    one = _without_other(one)
    side, size, _ = np.linalg.svd(one.by_force, full_matrices=False)
    across = np.swapaxes(side, 1, 2)
    left = one.residual - apply(side, apply(across, one.residual))
    widened = _memory(left, one.measured, 2 + one.other.shape[1])
    side = np.where((prior_sd[0] * size > 1.0)[..., None], across / np.sqrt(widened), 0.0)
    weigh[known] = side @ one.by_force
    told[known] = apply(side, one.residual) + apply(weigh[known], load[known, :2])
    common[known] = side @ one.by_shared
    return FrameForces(time, weigh, told, common, widened)


def _linear(bench: Bench, frames: IntArray, load: Array, place: Array, prior_sd: Array, seek_place: bool) -> _Linear:
    frame = FrameModel(bench, frames, place, prior_sd, seek_place)
    solved = model.solve(
        bench, (model.problem_apart if seek_place else model.problem_of)(bench, frames, place), load, place, None
    )
    tags = model.tags_of(bench, frames, solved, load, place)
    stands = solved.converged[:, None, None]
    own = np.column_stack([load, place]) if seek_place else load
    by_own, by_shared = (
        np.where(stands, each, 0.0) for each in (frame.own_slopes(tags), frame.flat(tags.by_shared @ bench.root))
    )
    return _Linear(
        residual=np.where(stands[..., 0], frame.away(tags.pose), 0.0),
        by_force=by_own[..., :2] / frame.sd[:2],
        by_other=by_own[..., 2:],
        other=((own - frame.mean) / frame.sd)[:, 2:],
        by_shared=by_shared,
        measured=(np.any(frame.whiten != 0.0, axis=-1) & stands).reshape(len(frames), -1),
    )


def _without_other(one: _Linear) -> _Linear:
    """With each frame's other unknowns integrated out: their prior is noise."""
    if not one.other.shape[1]:
        return one
    residual = one.residual + apply(one.by_other, one.other)
    side, size, _ = np.linalg.svd(one.by_other, full_matrices=False)
    less = 1.0 - 1.0 / np.sqrt(1.0 + size**2)  # (I + W W^T)^(-1/2) = I - U less U^T

    def without(values: Array) -> Array:
        return np.asarray(values - side @ (less[..., None] * (np.swapaxes(side, 1, 2) @ values)))

    return replace(
        one,
        residual=without(residual[..., None])[..., 0],
        by_force=without(one.by_force),
        by_shared=without(one.by_shared),
    )


def _memory(left: Array, measured: BoolArray, unknowns: int) -> float:
    """Variance of the mean of many frames over that of as many with white noise as stated; 1 or more.

    From what is `left` (F, 3 m) of the tags beside each frame's `unknowns`: half the mean square of its differences
    over `n` frames is `V (1 - rho_n)`.
    """
    if len(left) < _FEWEST:
        return 1.0
    numbers = measured.sum(axis=1)
    free = np.maximum(numbers - float(unknowns), 0.0) / np.maximum(numbers, 1)
    halves = []
    for n in range(1, int(_LONGEST * len(left)) + 1):
        both = measured[n:] & measured[:-n]
        expected = float(np.sum(both * (0.5 * (free[n:] + free[:-n]))[:, None]))
        squares = float(np.sum(np.where(both, left[n:] - left[:-n], 0.0) ** 2))
        halves.append(0.5 * squares / expected if expected > 0.0 else 0.0)
    whole = float(np.mean(halves[len(halves) // 2 :]))
    if whole <= 0.0:
        return 1.0
    alike = 1.0 - np.array(halves) / whole
    ends = np.flatnonzero(alike < _ALIKE)
    return float(max(whole * (1.0 + 2.0 * np.sum(alike[: ends[0] if ends.size else len(alike)])), 1.0))


# Some frames together with u, all that they share, in units of their priors' sds. With residuals r over the tags' noise
# and derivatives B, J each frame's own unknowns are eliminated: `(I + sum B^T P B) du = sum B^T P r - ...`,
# `P = I - J A^-1 J^T`, `A = J^T J + I`. A frame's own covariance is `A^-1 + G C G^T`, `G = A^-1 J^T B`, C that of u.

_ROUNDS = 20
_OWN_STEPS = 3  # of the frames' own unknowns for each of what they share
_REST_ROUNDS = 4
_SETTLED = 1e-2  # of the objective that a round must win
_SLIGHT = 2e-3  # of the objective: a round that wins no more than this is the last
_MOST_JOINT_DAMPING = 1e4  # damping: no step is left that lowers anything


@dataclass(frozen=True)
class Misfit:
    """Squared residuals of some frames and of what they share against the beam at rest, in units of their noise."""

    chi2: float
    freedom: int  # numbers measured, less the frames' own unknowns
    frames: int

    @property
    def ratio(self) -> float:
        """About 1 where beam, mounting and noise are as stated; NaN where nothing is left to tell."""
        return self.chi2 / self.freedom if self.freedom > 0 else float("nan")

    @property
    def probability(self) -> float:
        """Of residuals as large or larger, were all as stated."""
        return float(chi2.sf(self.chi2, self.freedom)) if self.freedom > 0 else float("nan")


@dataclass(frozen=True)
class _At:
    """Where the search stands."""

    shared: Array  # (r,) u
    own: Array  # (F, d) N, N, s
    tags: Tags
    residual: Array  # (F, 3 m) over the tags' noise
    objectives: Array  # (F,) squares of each frame

    @property
    def objective(self) -> float:
        return float(np.sum(self.objectives) + self.shared @ self.shared)


def rested(bench: Bench) -> Bench:
    """With what the tags at rest say (Gauss-Newton, the beam without a force)."""
    o, m = bench.observations, len(bench.observations.marker_s)
    seen = np.concatenate([o.rest_xy, o.rest_angle[:, None]], axis=1)
    if not np.isfinite(seen).any():
        return bench
    root, mean = bench.root, bench.mean
    none, at = np.zeros((1, 2)), np.ones(1)
    whiten, inner = whitening(seen, o.rest_covariance), np.eye(root.shape[1])
    for _ in range(_REST_ROUNDS):
        now = replace(bench, mean=mean)
        tags = model.tags_of(now, AT_REST, model.solve(now, model.rest_problem(now), none, at, None), none, at)
        rows = (whiten @ (tags.by_shared[0] @ root)).reshape(3 * m, -1)
        away = np.nan_to_num(seen - tags.pose[0]) + tags.by_shared[0] @ (mean - bench.mean)
        inner = np.linalg.inv(np.eye(root.shape[1]) + rows.T @ rows)
        mean = bench.mean + root @ (inner @ (rows.T @ (whiten @ away[..., None]).ravel()))
    return replace(bench, mean=mean, root=root @ np.linalg.cholesky(0.5 * (inner + inner.T)))


def together(
    bench: Bench, frames: IntArray, begin: Estimates, prior_sd: Array, *, seek_place: bool
) -> tuple[Bench, Estimates, Misfit]:
    """The bench as the `frames` (F,), rising, show it besides; what is known of them then; how well it fits."""
    return _Joint(bench, frames, begin.place, prior_sd, seek_place).run(begin)


class _Joint(FrameModel):
    """Gauss-Newton, damped."""

    def run(self, begin: Estimates) -> tuple[Bench, Estimates, Misfit]:
        own = np.column_stack([begin.force, begin.place]) if self.seek_place else begin.force
        now = self._at(np.zeros(self.bench.root.shape[1]), own)
        damping = 1e-4
        for _ in range(_ROUNDS):
            trial = self._at(*self._step(now, damping), now.tags.solved.q)
            if trial.objective < now.objective:
                won, now, damping = now.objective - trial.objective, trial, max(damping / 5.0, 1e-9)
                if won < max(_SETTLED, _SLIGHT * now.objective):
                    break
            else:
                damping *= 5.0
                if damping > _MOST_JOINT_DAMPING:
                    break
        return self._outcome(now)

    def _at(self, shared: Array, own: Array, near: Array | None = None) -> _At:
        bench = self._bench(shared)
        now = self._there(bench, shared, self.inside(own), near)
        for _ in range(_OWN_STEPS):
            slopes, z = self.own_slopes(now.tags), (now.own - self.mean) / self.sd
            inner = np.swapaxes(slopes, 1, 2) @ slopes + np.eye(len(self.sd))
            right = np.einsum("frd,fr->fd", slopes, now.residual) - z
            step = np.linalg.solve(inner, right[..., None])[..., 0]
            if not np.isfinite(now.objectives).all() or np.max(np.abs(step * right)) < _SETTLED:
                break
            trial = self._there(bench, shared, self.inside(now.own + self.sd * step), now.tags.solved.q)
            better = trial.objectives < now.objectives
            if not better.any():
                break
            own = np.where(better[:, None], trial.own, now.own)
            now = trial if better.all() else self._there(bench, shared, own, now.tags.solved.q)
        return now

    def _there(self, bench: Bench, shared: Array, own: Array, near: Array | None) -> _At:
        place = self.placed(own)
        problem = (model.problem_apart if self.seek_place else model.problem_of)(bench, self.frames, place)
        near = near if near is not None and near.shape[1] == problem.grid.nodes.shape[-1] else None
        solved = model.solve(bench, problem, own[:, : self.load], place, near)
        tags = model.tags_of(bench, self.frames, solved, own[:, : self.load], place, shared=False)
        residual = self.away(tags.pose)
        objectives = self.costs(residual, own)
        return _At(shared, own, tags, residual, np.where(solved.converged, objectives, np.inf))

    def _bench(self, shared: Array) -> Bench:
        return replace(self.bench, mean=self.bench.mean + self.bench.root @ shared)

    def _slopes(self, now: _At) -> tuple[Array, Array]:
        """The same, and (F, 3 m, r) with what is shared."""
        place = self.placed(now.own)
        tags = model.tags_of(self._bench(now.shared), self.frames, now.tags.solved, now.own[:, : self.load], place)
        return self.own_slopes(tags), self.flat(tags.by_shared @ self.bench.root)

    def _step(self, now: _At, damping: float) -> tuple[Array, Array]:
        own, shared = self._slopes(now)
        inner = np.swapaxes(own, 1, 2) @ own + np.eye(len(self.sd))
        inner = inner * (1.0 + damping * np.eye(len(self.sd)))
        right = np.einsum("frd,fr->fd", own, now.residual) - (now.own - self.mean) / self.sd
        across = np.swapaxes(own, 1, 2) @ shared
        down = np.linalg.solve(inner, np.concatenate([across, right[..., None]], axis=-1))
        count = len(now.shared)
        whole = (1.0 + damping) * np.eye(count) + np.einsum("frn,frk->nk", shared, shared)
        whole -= np.einsum("fdn,fdk->nk", across, down[..., :-1])
        pull = np.einsum("frn,fr->n", shared, now.residual) - now.shared - np.einsum("fdn,fd->n", across, down[..., -1])
        by = np.linalg.solve(whole, pull)
        return now.shared + by, now.own + self.sd * (down[..., -1] - down[..., :-1] @ by)

    def _outcome(self, now: _At) -> tuple[Bench, Estimates, Misfit]:
        own, shared = self._slopes(now)
        side, size, turn = np.linalg.svd(own, full_matrices=False)
        inner = np.swapaxes(turn, 1, 2) @ (turn / (1.0 + size[..., None] ** 2))
        down = inner @ np.swapaxes(own, 1, 2) @ shared
        # P = I - J A^-1 J^T = R^2, R = I - U (1 - (1 + size^2)^-1/2) U^T
        less = (1.0 - 1.0 / np.sqrt(1.0 + size**2))[..., None] * (np.swapaxes(side, 1, 2) @ shared)
        rows = (shared - side @ less).reshape(-1, shared.shape[-1])
        _, told, ways = np.linalg.svd(rows, full_matrices=True)
        told = np.pad(told, (0, len(ways) - len(told)))
        root = ways.T / np.sqrt(1.0 + told**2)
        left = root @ root.T
        covariance = self.sd[:, None] * (inner + down @ left @ np.swapaxes(down, 1, 2)) * self.sd
        bench = replace(self._bench(now.shared), root=self.bench.root @ root)
        squares = np.sum(now.residual**2, axis=1)
        measured = int(np.sum(np.any(self.whiten != 0.0, axis=-1)))
        whole = float(np.sum(squares) + now.shared @ now.shared)
        fit = Misfit(whole, measured - now.own.size, len(self.frames))
        place = self.placed(now.own)
        stands = np.where(now.tags.solved.converged, squares, np.inf)
        common = -(self.sd[:, None] * (down @ root))[:, : self.load]
        found = Estimates(now.own[:, : self.load], place, covariance, common, stands, squares, now.tags.pose)
        return bench, found, fit


# The forces of all frames of a recording: some frames together first, which tell what all share, then the others.

LEVEL = 0.95
TOUCH = float(chi2.ppf(LEVEL, 2))
_TOGETHER = 24  # frames that are taken together: so far apart that the tags' errors are each one's own
MOVED = 0.2  # of the largest displacement of the tags: frames that move less tell the bench nothing
_ODD = 5.0  # times the usual squared residual: such a frame has a wrong tag, and tells the bench nothing either
_SCAN = np.linspace(0.2, 1.0, 9)  # places where the search for the contact begins
_AS_WELL = float(chi2.ppf(LEVEL, 1))  # of the objective: two places explain a frame about as well
_APART = 0.1  # of the beam: closer places are one


@dataclass(frozen=True)
class Searched:
    """Forces of F frames, and the bench as the frames together show it."""

    bench: Bench
    found: Estimates
    other_place: Array  # (F,) s that explains a frame about as well; NaN where there is none
    misfit: Misfit | None  # None: no frame shows a force


def search(bench: Bench, frames: IntArray, place: Array | None, prior_sd: Array) -> Searched:
    """Of `frames` (F,), rising; `place` (F,) where the force acts, None: it is sought."""
    some = _together(bench, frames)
    begin, other = first(bench, frames[some], None if place is None else place[some], prior_sd)
    good = touches(begin) & (begin.chi2 < _ODD * max(float(np.nanmedian(begin.chi2)), 1.0))
    if not good.any():
        found, other = first(bench, frames, place, prior_sd)
        return Searched(bench, found, other, None)
    some, other = some[good], other[good]
    shown, joint, fit = together(bench, frames[some], begin.take(good), prior_sd, seek_place=place is None)
    rest = np.setdiff1d(np.arange(len(frames)), some)
    if not rest.size:
        return Searched(shown, joint, other, fit)
    near = np.argmin(np.abs(rest[:, None] - some), axis=1)
    if place is None:
        left = estimate(
            shown, frames[rest], joint.place[near], prior_sd, seek_place=True, force=joint.force[near], restarts=1
        )
    else:
        left = estimate(shown, frames[rest], place[rest], prior_sd, seek_place=False)
    order = np.argsort(np.concatenate([some, rest]))
    others = np.concatenate([other, other[near]])[order]
    return Searched(shown, joint.then(left).take(order), others, fit)


def touches(found: Estimates) -> BoolArray:
    """(F,) whether no load at all lies outside the 95 % region."""
    n = found.force.shape[1]
    known: BoolArray = np.asarray(np.isfinite(found.force).all(axis=1))
    out: BoolArray = np.zeros(len(known), dtype=np.bool_)
    solved = np.linalg.solve(found.covariance[known, :n, :n], found.force[known][..., None])[..., 0]
    out[known] = np.einsum("tc,tc->t", found.force[known], solved) > chi2.ppf(LEVEL, n)
    return out


def _together(bench: Bench, frames: IntArray) -> IntArray:
    """Which of the frames tell the bench: evenly spread among those in which the tags moved."""
    moved = np.nan_to_num(moved_by(bench.observations)[frames])
    rows = np.flatnonzero(moved >= MOVED * np.max(moved))
    return np.asarray(rows[np.linspace(0, len(rows) - 1, min(_TOGETHER, len(rows))).astype(int)])


def first(bench: Bench, frames: IntArray, place: Array | None, prior_sd: Array) -> tuple[Estimates, Array]:
    """Each frame by itself, and another place that does about as well."""
    if place is not None:
        return estimate(bench, frames, place, prior_sd, seek_place=False), np.full(len(frames), np.nan)
    return _at_unknown_place(bench, frames, prior_sd)


def _at_unknown_place(bench: Bench, frames: IntArray, prior_sd: Array) -> tuple[Estimates, Array]:
    """From the place of a scan that explains a frame best; and (F,) another that does about as well, NaN: none."""
    scan = [estimate(bench, frames, np.full(len(frames), s), prior_sd, seek_place=False, restarts=0) for s in _SCAN]
    objective = np.stack([one.objective for one in scan])  # (places, F)
    best, every = np.argmin(objective, axis=0), np.arange(len(frames))
    force = np.nan_to_num(np.stack([one.force for one in scan])[best, every])
    found = estimate(bench, frames, _SCAN[best], prior_sd, seek_place=True, force=force)
    padded = np.pad(objective, ((1, 1), (0, 0)), constant_values=np.inf)
    valley = (objective <= padded[:-2]) & (objective <= padded[2:])
    far = np.abs(_SCAN[:, None] - found.place) > np.maximum(_APART, 2.0 * np.sqrt(found.covariance[:, -1, -1]))
    rivals = np.where(valley & far, objective, np.inf)
    second = np.argmin(rivals, axis=0)
    as_well = rivals[second, every] < found.objective + _AS_WELL
    return found, np.where(as_well, _SCAN[second], np.nan)
