"""Some frames together: their forces and all that they share, maximum a posteriori by Gauss-Newton.

In units of its prior's sd let u be what the frames share, after the beam at rest was seen, and f the unknowns of each
frame. With residuals r over the tags' noise, and B, J their derivatives, each frame's own unknowns are eliminated:
`(I + sum B^T P B) du = sum B^T P r - ...`, `P = I - J A^-1 J^T`, `A = J^T J + I`. The covariance of a frame's own is
`A^-1 + G C G^T`, `G = A^-1 J^T B`, C that of u.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from onebend.learning.model.frames import whitening
from onebend.learning.sensing.bench import INNERMOST, Bench, problem_apart, problem_of, rest_problem, solve
from onebend.learning.sensing.estimate import Estimates, with_place
from onebend.learning.sensing.tags import AT_REST, Tags, tags_of
from onebend.records import Array, IntArray

_ROUNDS = 20
_OWN_STEPS = 3  # of the frames' own unknowns for each of what they share
_REST_ROUNDS = 4
_SETTLED = 1e-2  # of the objective that a round must win
_SLIGHT = 2e-3  # of the objective: a round that wins no more than this is the last
_MOST = 1e4  # damping: no step is left that lowers anything


@dataclass(frozen=True)
class Misfit:
    """Squared residuals of some frames and of what they share against the beam at rest, in units of their noise."""

    chi2: float
    freedom: int  # numbers measured, less the frames' own unknowns
    frames: int
    evidence: float  # log but for a constant (Laplace): the frames' own unknowns and all that they share integrated out

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
        """All squares."""
        return float(np.sum(self.objectives) + self.shared @ self.shared)


def rested(bench: Bench) -> Bench:
    """With what the tags at rest say (Gauss-Newton, the beam without a force)."""
    o, m = bench.observations, len(bench.observations.marker_s)
    seen = np.concatenate([o.rest_xy, o.rest_angle[:, None]], axis=1)
    if not np.isfinite(seen).any():
        return bench
    root, mean, forces = bench.root, bench.mean, len(bench.mean[bench.parts["place"]])
    none, at = np.zeros((1, 2 * forces)), np.ones(1) if forces == 1 else np.ones((1, forces))
    whiten, inner = whitening(seen, o.rest_covariance), np.eye(root.shape[1])
    for _ in range(_REST_ROUNDS):
        now = replace(bench, mean=mean)
        tags = tags_of(now, AT_REST, solve(now, rest_problem(now), none, at, None), none, at)
        rows = (whiten @ (tags.by_shared[0] @ root)).reshape(3 * m, -1)
        away = np.nan_to_num(seen - tags.pose[0]) + tags.by_shared[0] @ (mean - bench.mean)
        inner = np.linalg.inv(np.eye(root.shape[1]) + rows.T @ rows)
        mean = bench.mean + root @ (inner @ (rows.T @ (whiten @ away[..., None]).ravel()))
    return replace(bench, mean=mean, root=root @ np.linalg.cholesky(0.5 * (inner + inner.T)))


def together(
    bench: Bench, frames: IntArray, begin: Estimates, prior_sd: Array, *, seek_place: bool
) -> tuple[Bench, Estimates, Misfit]:
    """The bench as the `frames` (F,), rising, show it besides; what is known of them then; how well it fits."""
    return _Joint(bench, frames, prior_sd, seek_place).run(begin)


class _Joint:
    """Gauss-Newton, damped."""

    def __init__(self, bench: Bench, frames: IntArray, prior_sd: Array, seek_place: bool) -> None:
        o = bench.observations
        self.bench, self.frames, self.seek_place = bench, frames, seek_place
        self.seen = np.concatenate([o.xy[frames], o.angle[frames][..., None]], axis=-1)
        self.whiten = whitening(self.seen, o.covariance[frames])
        self.sd, self.mean = with_place(prior_sd, seek_place)
        self.load = len(prior_sd)

    def run(self, begin: Estimates) -> tuple[Bench, Estimates, Misfit]:
        self.place = begin.place
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
                if damping > _MOST:
                    break
        return self._outcome(now)

    def _at(self, shared: Array, own: Array, near: Array | None = None) -> _At:
        """With the frames' own unknowns brought to where they fit best, by a few steps each."""
        bench = self._bench(shared)
        now = self._there(bench, shared, self._inside(own), near)
        for _ in range(_OWN_STEPS):
            slopes, z = self._own_slopes(now.tags), (now.own - self.mean) / self.sd
            inner = np.swapaxes(slopes, 1, 2) @ slopes + np.eye(len(self.sd))
            right = np.einsum("frd,fr->fd", slopes, now.residual) - z
            step = np.linalg.solve(inner, right[..., None])[..., 0]
            if not np.isfinite(now.objectives).all() or np.max(np.abs(step * right)) < _SETTLED:
                break
            trial = self._there(bench, shared, self._inside(now.own + self.sd * step), now.tags.solved.q)
            better = trial.objectives < now.objectives
            if not better.any():
                break
            own = np.where(better[:, None], trial.own, now.own)
            now = trial if better.all() else self._there(bench, shared, own, now.tags.solved.q)
        return now

    def _there(self, bench: Bench, shared: Array, own: Array, near: Array | None) -> _At:
        place = own[:, -1] if self.seek_place else self.place
        problem = (problem_apart if self.seek_place else problem_of)(bench, self.frames, place)
        near = near if near is not None and near.shape[1] == problem.grid.nodes.shape[-1] else None
        solved = solve(bench, problem, own[:, : self.load], place, near)
        tags = tags_of(bench, self.frames, solved, own[:, : self.load], place, shared=False)
        residual = self._flat(np.nan_to_num(self.seen - tags.pose)[..., None])[..., 0]
        objectives = np.sum(residual**2, axis=1) + np.sum(((own - self.mean) / self.sd) ** 2, axis=1)
        return _At(shared, own, tags, residual, np.where(solved.converged, objectives, np.inf))

    def _inside(self, own: Array) -> Array:
        return np.column_stack([own[:, :-1], np.clip(own[:, -1], INNERMOST, 1.0)]) if self.seek_place else own

    def _bench(self, shared: Array) -> Bench:
        return replace(self.bench, mean=self.bench.mean + self.bench.root @ shared)

    def _flat(self, of_tags: Array) -> Array:
        """(F, 3 m, n) of (F, m, 3, n), over the tags' noise."""
        return np.asarray((self.whiten @ of_tags).reshape(len(of_tags), -1, of_tags.shape[-1]))

    def _own_slopes(self, tags: Tags) -> Array:
        """(F, 3 m, d) with the frames' own unknowns, over their priors' sd."""
        own = tags.by_load
        if self.seek_place:
            own = np.concatenate([own, self.bench.observations.length * tags.by_place], axis=-1)
        return self._flat(own * self.sd)

    def _slopes(self, now: _At) -> tuple[Array, Array]:
        """The same, and (F, 3 m, r) with what is shared."""
        place = now.own[:, -1] if self.seek_place else self.place
        tags = tags_of(self._bench(now.shared), self.frames, now.tags.solved, now.own[:, : self.load], place)
        return self._own_slopes(tags), self._flat(tags.by_shared @ self.bench.root)

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
        spread = float(np.sum(np.log1p(size**2)) + np.sum(np.log1p(told**2)))
        evidence = -0.5 * (now.objective + spread)
        whole = float(np.sum(squares) + now.shared @ now.shared)
        fit = Misfit(whole, measured - now.own.size, len(self.frames), evidence)
        place = now.own[:, -1] if self.seek_place else self.place
        stands = np.where(now.tags.solved.converged, squares, np.inf)
        common = -(self.sd[:, None] * (down @ root))[:, : self.load]
        found = Estimates(now.own[:, : self.load], place, covariance, common, stands, squares, now.tags.pose)
        return bench, found, fit
