"""The force of each frame: maximum a posteriori by Gauss-Newton, many frames at once.

Whitened by the tags' noise and by what the frames share (`bench.py`), the residuals r of a frame and their derivatives
J with its own unknowns u, in units of their prior's sd, give steps `(1 + d) (J^T J + I) du = J^T r - u`; d, of each
frame, grows where a step did not lower `|r|^2 + |u|^2` and falls where it did. The covariance is `(J^T J + I)^-1`.
What the frames share counts as it does at the force where a search begins; a second one begins where the first ended.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.learning.model.frames import whitening
from onebend.learning.sensing.begin import first_forces
from onebend.learning.sensing.bench import INNERMOST, Bench, problem_apart, problem_of, solve
from onebend.learning.sensing.tags import poses_of, tags_of
from onebend.records import Array, BoolArray, IntArray

CHUNK = 250  # frames solved together
_STEPS = 40
_STRIDE = 1.5  # of k/L: no longer step of the force at once
_FAR = 3.0  # times what is usual
_LAST = 3e-3  # posterior sds: after a step this small a further one is not worth its cost: it is its square
_SEARCHES = 2
_HALVINGS = 6  # of a first force under which the beam does not stand
_MOST = 1e8  # damping: no step is left that lowers anything
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

    force: Array  # (F, n) N, the load (`bench.py`)
    place: Array  # (F,) or (F, 2) s
    covariance: Array  # (F, d, d) of load and, where it was sought, place: N, N m, s
    common: Array  # (F, n, r) N, of it what one sd of each way in which the bench is off does to the load
    objective: Array  # (F,) squared residuals, whitened, and the prior's part
    chi2: Array  # (F,) squared residuals, whitened
    pose: Array  # (F, m, 3) the tags that belong to it

    def take(self, rows: IntArray | BoolArray) -> Estimates:
        """Of some frames."""
        return Estimates(*(values[rows] for values in vars(self).values()))

    def then(self, other: Estimates) -> Estimates:
        """Followed by those of other frames."""
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
    where it acts or, with `seek_place`, where the search begins; two places, (F, 2), are said. `prior_sd` (n,): of each
    number of the load, mean zero."""
    first = first_forces(bench, frames, place, prior_sd) if force is None else force
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


class _Search:
    """Gauss-Newton for one chunk of frames."""

    def __init__(self, bench: Bench, frames: IntArray, place: Array, prior_sd: Array, seek_place: bool) -> None:
        o = bench.observations
        self.bench, self.frames, self.place, self.seek_place = bench, frames, place, seek_place
        self.seen = np.concatenate([o.xy[frames], o.angle[frames][..., None]], axis=-1)
        self.whiten = whitening(self.seen, o.covariance[frames])
        self.sd, self.mean = with_place(prior_sd, seek_place)
        self.load = len(prior_sd)
        self.problem = problem_of(bench, frames, place)
        stiff = _STRIDE * float(np.mean(self.problem.k))
        self.longest = np.full(len(self.sd), stiff / bench.observations.length)
        if self.load % 2:
            self.longest[self.load - 1] = stiff
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
            trial = self._inside(state.unknown[rows] + step)
            there = self._solved(rows, trial, state.q[rows])
            away = self._residual(rows, state.root[rows], poses_of(self.bench, self.frames[rows], there)[0])
            lower = self._objective(away, trial) < self._objective(state.residual[rows], state.unknown[rows])
            better = np.flatnonzero(there.converged & lower)
            if better.size:
                there = there.take(better)
                state.put(rows[better], self._state(rows[better], trial[better], there, state.root[rows[better]]))
            won = np.isin(np.arange(len(rows)), better)
            damping[rows] = np.where(won, np.maximum(damping[rows] / 30.0, 1e-12), 10.0 * damping[rows])
            done = (size < _LAST) | (damping[rows] > _MOST)
            rows = rows[~done]

    def _at(self, rows: IntArray, state: _SearchState) -> Equilibrium:
        """The beam as it stands in the state."""
        found = self._solved(rows, state.unknown, state.q)
        return replace(found, converged=found.converged & state.stands)

    def _estimates(self, state: _SearchState) -> Estimates:
        _, size, turn = np.linalg.svd(state.slopes, full_matrices=False)
        root = np.swapaxes(turn, 1, 2) / np.sqrt(1.0 + size[:, None] ** 2)
        covariance = self.sd[:, None] * (root @ np.swapaxes(root, 1, 2)) * self.sd
        known = np.where(state.stands[:, None], state.unknown, np.nan)
        place = known[:, -1] if self.seek_place else np.where(state.stands, self.place.T, np.nan).T
        objective = np.where(state.stands, self._objective(state.residual, state.unknown), np.inf)
        chi2 = np.sum(state.residual**2, axis=1)
        gain = self.sd[:, None] * (root @ np.swapaxes(state.slopes @ root, 1, 2))
        common = -(gain @ state.shared)[:, : self.load]
        return Estimates(known[:, : self.load], place, covariance, common, objective, chi2, state.pose)

    def _solved(self, rows: IntArray, unknown: Array, start: Array | None) -> Equilibrium:
        """The beam in frames `rows` of the chunk."""
        if self.seek_place:
            place, problem = unknown[:, -1], problem_apart(self.bench, self.frames[rows], unknown[:, -1])
        else:
            place, problem = self.place[rows], self.problem.take(rows)
        return solve(self.bench, problem, unknown[:, : self.load], place, start)

    def _state(self, rows: IntArray, unknown: Array, solved: Equilibrium, root: Array | None) -> _SearchState:
        """Whitened by the tags' noise and what the frames share, as it is here, or by the `root` (F, 3 m, 3 m)."""
        place = unknown[:, -1] if self.seek_place else self.place[rows]
        tags = tags_of(self.bench, self.frames[rows], solved, unknown[:, : self.load], place, shared=root is None)
        stands, own = solved.converged[:, None, None], tags.by_load
        if self.seek_place:
            own = np.concatenate([own, self.bench.observations.length * tags.by_place], axis=-1)
        shared = np.zeros((len(rows), 3 * self.seen.shape[1], 0))
        if root is None:
            shared = np.nan_to_num(np.where(stands, self._flat(rows, tags.by_shared @ self.bench.root), 0.0))
            size, ways = np.linalg.eigh(shared @ np.swapaxes(shared, 1, 2))
            root = (ways / np.sqrt(1.0 + np.maximum(size, 0.0))[:, None]) @ np.swapaxes(ways, 1, 2)
        slopes = root @ np.where(stands, self._flat(rows, own * self.sd), 0.0)
        residual = self._residual(rows, root, tags.pose)
        return _SearchState(
            unknown.copy(), solved.q, solved.converged, tags.pose, root, residual, slopes, root @ shared
        )

    def _residual(self, rows: IntArray, root: Array, pose: Array) -> Array:
        return apply(root, self._flat(rows, np.nan_to_num(self.seen[rows] - pose)[..., None])[..., 0])

    def _flat(self, rows: IntArray, of_tags: Array) -> Array:
        """(F, 3 m, n) of (F, m, 3, n), over the tags' noise."""
        return np.asarray((self.whiten[rows] @ of_tags).reshape(len(of_tags), -1, of_tags.shape[-1]))

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

    def _objective(self, residual: Array, unknown: Array) -> Array:
        return np.asarray(np.sum(residual**2, axis=1) + np.sum(((unknown - self.mean) / self.sd) ** 2, axis=1))

    def _inside(self, unknown: Array) -> Array:
        if self.seek_place:
            unknown = np.column_stack([unknown[:, :-1], np.clip(unknown[:, -1], INNERMOST, 1.0)])
        return unknown
