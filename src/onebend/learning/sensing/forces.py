"""The force of each frame: maximum a posteriori by Gauss-Newton, many frames at once.

Residuals of a frame are whitened by the tags' noise and by what frames share (`model.py`), which counts as at the start
of a search; a second search begins where the first ended.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.special import chdtrc, chdtri

from onebend.beam.grid import apply
from onebend.gauss_newton import Linearised, MostProbable, SearchLimits, most_probable
from onebend.learning.fit_data import FitData
from onebend.learning.frames import moved_by, whitened
from onebend.learning.prediction import Prediction
from onebend.learning.sensing import model
from onebend.learning.sensing.model import AT_REST, INNERMOST, Bench
from onebend.records import Array, BoolArray, IntArray

CHUNK = 250  # frames solved together
_STRIDE = 1.5  # of k/L: no longer step of the force at once
_FAR = 3.0  # times what is usual
_TOLERANCES = (0.1, 3e-3)  # posterior sds, of the last step of each search; what is left is its square
# Of a frame after the other: posterior sds of the last step, and rounds, each with the noise as it counts there
_CLOSE, _MOST_FOLLOWED = 0.3, 8
_ROUNDING = 1e-12  # of the variance of all that frames share: next to it noise of sd one is lost in rounding
_ROUNDS, _SETTLED = 8, 0.03  # with the noise as it counts where a search has ended, and posterior sds of the last step
_HALVINGS = 6  # of a first force under which the beam does not stand
PLACE_PRIOR = (0.5, 0.29)  # mean and sd of a place of which nothing is known: those of an even spread over the beam


@dataclass(frozen=True)
class Estimates:
    """Forces of F frames. NaN where none was found."""

    force: Array  # (F, n) N, the load (`model.py`)
    place: Array  # (F,) s
    covariance: Array  # (F, d, d) of load and, where it was sought, place: N, N m, s
    common: Array  # (F, n, r) N, effect on the load of one sd of each error of the bench
    objective: Array  # (F,) squared residuals, whitened, the prior's part, and the log of the noise's determinant
    chi2: Array  # (F,) squared residuals, whitened
    pose: Array  # (F, m, 3) the tags that belong to it
    settled: BoolArray  # (F,) nearly the same with noise as it counts there

    def put(self, rows: IntArray, other: Estimates) -> None:
        """Estimates of some frames in their place."""
        for name, values in vars(self).items():
            values[rows] = getattr(other, name)

    def take(self, rows: IntArray | BoolArray) -> Estimates:
        return Estimates(*(values[rows] for values in vars(self).values()))

    def then(self, other: Estimates) -> Estimates:
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Estimates(*(np.concatenate(pair) for pair in pairs))


@dataclass(frozen=True)
class Around:
    """F frames to first order about their unknowns."""

    own: Array  # (F, d)
    now: Prediction
    by_own: Array  # (F, m, 3, n + 1) of the tags, with each frame's load and its place [m]
    by_shared: Array  # (F, m, 3, r) of the tags, per sd of each error that the frames share

    @property
    def shared(self) -> Array:
        """(F, 3 m, r), over the tags' noise."""
        return _known(self.now, self.by_shared)

    def showing(self, seen: Array, whiten: Array) -> Around:
        """The same shapes in other frames, with tags at `seen` (F, m, 3)."""
        return replace(self, now=replace(self.now, data=replace(self.now.data, measured=seen, whiten=whiten)))


def _known(now: Prediction, columns: Array) -> Array:
    """(F, 3 m, n) of columns (F, m, 3, n), over the tags' noise; zero where there is no equilibrium."""
    return np.where(now.solved.converged[:, None, None], np.nan_to_num(whitened(now.data.whiten, columns)), 0.0)


class FrameModel:
    """Some frames and their unknowns: the load of each and, where it is sought, its place."""

    def __init__(self, bench: Bench, frames: IntArray, place: Array, prior_sd: Array, seek_place: bool) -> None:
        self.bench, self.frames, self.place, self.seek_place = bench, frames, place, seek_place
        self.prior_sd = prior_sd
        self.sd = np.append(prior_sd, PLACE_PRIOR[1]) if seek_place else prior_sd
        self.mean = np.append(0.0 * prior_sd, PLACE_PRIOR[0]) if seek_place else 0.0 * prior_sd
        self.load = len(prior_sd)
        beyond = np.full(self.load, np.inf)  # a place is on the beam
        self.within = (np.append(-beyond, INNERMOST), np.append(beyond, 1.0)) if seek_place else (-np.inf, np.inf)

    def moved(self, shared: Array) -> FrameModel:
        """With what the frames share (r,) sds away from its mean."""
        bench = replace(self.bench, mean=self.bench.mean + self.bench.root @ shared)
        return FrameModel(bench, self.frames, self.place, self.prior_sd, self.seek_place)

    def at(self, rows: IntArray, own: Array, near: Array | None = None) -> Prediction:
        """Of `rows` of the frames with unknowns `own` (F, d), from shapes `near` (F, Q)."""
        if self.seek_place or len(rows) < len(self.frames):
            data = self.bench.at(self.frames[rows], self.placed(own, rows), apart=self.seek_place)
        else:
            data = self.every
        return self.bench.predicted(data, own[:, : self.load], near)

    @cached_property
    def every(self) -> FitData:
        """Of all frames at their places."""
        return self.bench.at(self.frames, self.place)

    def linearise(self, rows: IntArray, own: Array, near: Array | None, root: Array | None = None) -> Linearised:
        """The same for the search, over the tags' noise; or over all noise, with its `root` (F, 3 m, 3 m)."""
        now = self.at(rows, own, near)
        return self.over_noise(now, now.by_own(place=self.seek_place), None if root is None else root[rows])

    def about(self, own: Array, near: Array | None = None) -> Around:
        """All frames about unknowns `own` (F, d), from shapes `near` (F, Q)."""
        return self.around(own, self.at(np.arange(len(own)), own, near))

    def around(self, own: Array, now: Prediction) -> Around:
        return Around(own, now, *self.bench.derivatives(now))

    def over_noise(self, now: Prediction, by_own: Array, root: Array | None = None) -> Linearised:
        """With derivatives `by_own` (F, m, 3, d or more); over the tags' noise alone, or over all."""
        slopes = by_own[..., : len(self.sd)]
        if self.seek_place:
            slopes = slopes * np.append(np.ones(self.load), self.bench.observations.length)
        both = np.concatenate([slopes, np.nan_to_num(now.data.measured - now.pose)[..., None]], axis=-1)
        both = _known(now, both)
        both = both if root is None else root @ both
        return Linearised(both[..., -1], both[..., :-1], now.solved.converged, now.solved.q)

    def placed(self, own: Array, rows: IntArray | slice = slice(None)) -> Array:
        """(F,) places of the loads."""
        return own[:, -1] if self.seek_place else self.place[rows]

    def begun(self, own: Array) -> Around:
        """About first unknowns (F, d), or loads a part as large where the beam does not stand under those."""
        own, rows = own.copy(), np.arange(len(own))
        now = self.at(rows, own)
        for _ in range(_HALVINGS):
            if now.solved.converged.all():
                break
            own[~now.solved.converged, : self.load] *= 0.5
            now = self.at(rows, own)
        return self.around(own, now)

    def limits(self, tolerance: float, around: Around) -> SearchLimits:
        """With a last step of `tolerance` posterior sds; it lowers the objective by the square."""
        stiff = _STRIDE * float(np.mean(around.now.solved.problem.k))
        longest = np.full(len(self.sd), stiff / self.bench.observations.length)
        longest[2 : self.load] = stiff
        if self.seek_place:
            longest[-1] = np.inf
        return SearchLimits(tolerance=tolerance, decrease=tolerance**2, longest=longest, within=self.within)

    def searched(self, around: Around, tolerances: tuple[float, ...] = _TOLERANCES) -> tuple[Estimates, Around]:
        """The most probable unknowns, from those of `around` on."""
        feasible = np.ones(len(around.own), dtype=bool)
        for tolerance in tolerances:
            root = _whitening(around.shared)
            begin, limits = self.over_noise(around.now, around.by_own, root), self.limits(tolerance, around)
            found = most_probable(partial(self.linearise, root=root), begin, around.own, self.mean, self.sd, limits)
            feasible &= found.at.feasible & np.isfinite(found.objective)
            around = self.about(found.x, found.at.warm)
        root = _whitening(around.shared)  # noise at the end is another than on the way there
        at, limits = self.over_noise(around.now, around.by_own, root), replace(self.limits(_SETTLED, around), steps=1)
        at = replace(at, feasible=at.feasible & feasible)
        found = most_probable(partial(self.linearise, root=root), at, around.own, self.mean, self.sd, limits)
        return self._estimates(found, root, around, root @ around.shared), around

    def followed(self, around: Around) -> tuple[Estimates, Around]:
        """The same of one frame that is near, but for the common errors: noise counts as at each step, and the last one
        is taken to first order. Near a buckling load that noise changes much from frame to frame."""
        for number in range(_MOST_FOLLOWED):
            root, found, after = self._stepped(around, _CLOSE if number else 0.0)
            if after is None:
                return self._estimates(found, root, around, root[..., :0]), around
            if not np.array_equal(found.x, after.own):
                break
            around = after
        return self.searched(around)

    def _stepped(self, around: Around, tolerance: float) -> tuple[Array, MostProbable, Around | None]:
        """What whitens, one step on, and what was seen where it ended; None: it was small."""
        root, looks = _whitening(around.shared), []

        def linearise(_: IntArray, own: Array, near: Array) -> Linearised:
            looks.append(self.about(own, near))
            return self.over_noise(looks[-1].now, looks[-1].by_own, root)

        begin = self.over_noise(around.now, around.by_own, root)
        limits = replace(self.limits(tolerance, around), steps=1)
        found = most_probable(linearise, begin, around.own, self.mean, self.sd, limits)
        return root, found, looks[0] if looks else None

    def _estimates(self, found: MostProbable, whiten: Array, around: Around, shared: Array) -> Estimates:
        noise = -2.0 * np.sum(np.log(np.diagonal(whiten, axis1=1, axis2=2)), axis=1)
        root, known = found.root, np.where(found.at.feasible[:, None], found.x, np.nan)
        place = known[:, -1] if self.seek_place else np.where(found.at.feasible, self.place, np.nan)
        return Estimates(
            force=known[:, : self.load],
            place=place,
            covariance=root @ np.swapaxes(root, 1, 2),
            common=-(found.by_residual(root) @ shared)[:, : self.load],
            objective=found.objective + noise,
            chi2=np.sum(found.at.residual**2, axis=1),
            pose=around.now.pose,
            settled=found.converged | ~found.at.feasible,
        )


def _whitening(shared: Array) -> Array:
    """(F, 3 m, 3 m), lower triangular, that whitens noise of sd one and what the frames share (F, 3 m, r)."""
    return np.asarray(np.linalg.inv(noise_root(shared @ np.swapaxes(shared, 1, 2))))


def noise_root(common: Array) -> Array:
    """(..., R, R) lower factors of the covariance of noise of sd one and of errors of the covariance `common`."""
    noise = 1.0 + _ROUNDING * np.trace(common, axis1=-2, axis2=-1)
    return np.asarray(np.linalg.cholesky(common + noise[..., None, None] * np.eye(common.shape[-1])))


def estimate(
    bench: Bench,
    frames: IntArray,
    place: Array,
    prior_sd: Array,
    *,
    seek_place: bool,
    force: Array | None = None,
    restarts: int = 4,
    tolerances: tuple[float, ...] = _TOLERANCES,
) -> Estimates:
    """The force in `frames` (F,), rising, from `force` (F, 2) N (default: `model.first_forces`) at `place` (F,), which
    is where it acts or, with `seek_place`, where the search begins. `prior_sd` (n,): of each number of the load, mean
    zero."""

    def searched(frames: IntArray, place: Array, force: Array, tolerances: tuple[float, ...]) -> Estimates:
        own, parts = np.column_stack([force, place]) if seek_place else force, []
        for chunk in (slice(i, i + CHUNK) for i in range(0, len(frames), CHUNK)):
            frame = FrameModel(bench, frames[chunk], place[chunk], prior_sd, seek_place)
            parts.append(frame.searched(frame.begun(own[chunk]), tolerances)[0])
        return Estimates(*(np.concatenate(each) for each in zip(*(vars(one).values() for one in parts), strict=True)))

    first = model.first_forces(bench, frames, place, prior_sd) if force is None else force
    found = searched(frames, place, first, tolerances)
    for _ in range(_ROUNDS if restarts else 0):
        rows = np.flatnonzero(~found.settled)
        if not rows.size:
            break
        at = found.place[rows] if seek_place else place[rows]
        again = searched(frames[rows], at, found.force[rows], (_SETTLED,))
        found.settled[rows] = True
        better = np.flatnonzero(again.objective < found.objective[rows])
        found.put(rows[better], again.take(better))
    for _ in range(restarts):  # frames that ended far from what their neighbours explain begin anew where those ended
        numbers = np.sum(np.isfinite(bench.observations.xy[frames]), axis=(1, 2))
        lost = np.flatnonzero(~(found.chi2 < _FAR * np.maximum(numbers, np.nanmedian(found.chi2))))
        good = np.setdiff1d(np.arange(len(frames)), lost)
        if not (lost.size and good.size):
            break
        near = good[np.argmin(np.abs(good - lost[:, None]), axis=1)]
        at = found.place[near] if seek_place else place[lost]
        again = searched(frames[lost], at, found.force[near], tolerances)
        better = np.flatnonzero(again.objective < found.objective[lost])
        if not better.size:
            break
        found.put(lost[better], again.take(better))
    return found


# Some frames together with u, all that they share, in units of their priors' sds: for each u the frames' own unknowns
# are the most probable ones. With derivatives J of the residuals with a frame's own unknowns (over their priors' sds,
# whose part stands below) and B with u, the slopes with u are `P B`, `P = I - J (J^T J)^-1 J^T`. A frame's own
# covariance is `A^-1 + G C G^T`, `A = J^T J`, `G = A^-1 J^T B`, C that of u.

# A decrease of 2e-3 left forces of the track single_003 up to 0.17 sds from those of a search to the end.
_TOGETHER = SearchLimits(steps=20, tolerance=0.1, decrease=2e-4, damping=1e-3)
_OWN = SearchLimits(steps=3, tolerance=0.1)  # of the frames' own unknowns for each of what they share
_AT_REST = SearchLimits(tolerance=1e-3)


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
        return float(chdtrc(self.freedom, self.chi2)) if self.freedom > 0 else float("nan")


def rested(bench: Bench) -> Bench:
    """With what the tags at rest say."""
    if not np.isfinite(bench.seen[AT_REST]).any():
        return bench
    none, at = np.zeros((1, 2)), np.ones(1)
    frame = FrameModel(bench, AT_REST, at, np.ones(2), False)

    def linearise(_: IntArray, shared: Array, near: Array | None = None) -> Linearised:
        there = frame.moved(shared[0])
        around = there.about(none, near)
        return replace(there.over_noise(around.now, around.by_own), slopes=around.shared)

    count = bench.root.shape[1]
    nothing, one = np.zeros((1, count)), np.zeros(1, dtype=np.int64)
    found = most_probable(linearise, linearise(one, nothing), nothing, nothing[0], np.ones(count), _AT_REST)
    return replace(frame.moved(found.x[0]).bench, root=bench.root @ found.root[0])


def together(
    bench: Bench, frames: IntArray, begin: Estimates, prior_sd: Array, *, seek_place: bool
) -> tuple[Bench, Estimates, Misfit]:
    """The bench as the `frames` (F,), rising, show it besides; what is known of them then; how well it fits."""
    return _Joint(bench, frames, begin.place, prior_sd, seek_place).run(begin)


@dataclass(frozen=True)
class _Common:
    """Where the search for what frames share stands."""

    shared: Array  # (r,) u
    around: Around
    residual: Array  # (F, 3 m) over the tags' noise
    inner: Array  # (F, d, d) root of A^-1
    down: Array  # (F, d, r) G
    objective: float


class _Joint(FrameModel):
    """Gauss-Newton for what the frames share, each frame's own unknowns being the most probable ones for it."""

    def run(self, begin: Estimates) -> tuple[Bench, Estimates, Misfit]:
        own = np.column_stack([begin.force, begin.place]) if self.seek_place else begin.force
        every, count = np.arange(len(own)), self.bench.root.shape[1]
        prior, limits = np.tile(np.eye(len(self.sd)), (len(own), 1, 1)), replace(_OWN, within=self.within)
        best: _Common | None = None

        def linearise(_: IntArray, shared: Array, __: Array) -> Linearised:
            nonlocal best
            frame, first, near = self.moved(shared[0]), own, None
            if best is not None:
                first = best.around.own - self.sd * apply(best.down, shared[0] - best.shared)
                first = np.clip(first, *self.within)
                near = best.around.now.solved.q
            begin = frame.linearise(every, first, near)
            found = most_probable(frame.linearise, begin, first, self.mean, self.sd, limits)
            around = frame.about(found.x, found.at.warm)
            at = frame.over_noise(around.now, around.by_own)
            side, corner = np.linalg.qr(np.concatenate([at.slopes * self.sd, prior], axis=1))
            rows = np.pad(around.shared, ((0, 0), (0, len(self.sd)), (0, 0)))
            across = np.swapaxes(side, 1, 2) @ rows
            residual = np.concatenate([at.residual, (self.mean - found.x) / self.sd], axis=1)
            feasible = bool(at.feasible.all())
            objective = float(np.sum(residual**2) + shared[0] @ shared[0])
            if feasible and (best is None or objective < best.objective):
                inner = np.linalg.inv(corner)
                best = _Common(shared[0], around, at.residual, inner, inner @ across, objective)
            slopes = (rows - side @ across).reshape(1, -1, count)
            return Linearised(residual.reshape(1, -1), slopes, np.array([feasible]), np.zeros((1, 0)))

        nothing, unit = np.zeros((1, count)), np.ones(count)
        first = linearise(every[:1], nothing, nothing)
        found = most_probable(linearise, first, nothing, nothing[0], unit, _TOGETHER)
        last = MostProbable.of(linearise(every[:1], found.x, nothing), found.x, nothing[0], unit)
        assert best is not None
        return self._outcome(best, last.root[0])

    def _outcome(self, best: _Common, root: Array) -> tuple[Bench, Estimates, Misfit]:
        bench, of_shared = self.moved(best.shared).bench, best.down @ root
        covariance = best.inner @ np.swapaxes(best.inner, 1, 2) + of_shared @ np.swapaxes(of_shared, 1, 2)
        squares, around = np.sum(best.residual**2, axis=1), best.around
        measured = int(np.sum(np.any(around.now.data.whiten != 0.0, axis=-1)))
        fit = Misfit(float(np.sum(squares) + best.shared @ best.shared), measured - around.own.size, len(self.frames))
        found = Estimates(
            force=around.own[:, : self.load],
            place=self.placed(around.own),
            covariance=self.sd[:, None] * covariance * self.sd,
            common=-(self.sd[:, None] * of_shared)[:, : self.load],
            objective=squares,
            chi2=squares,
            pose=around.now.pose,
            settled=np.ones(len(squares), dtype=bool),
        )
        return replace(bench, root=self.bench.root @ root), found, fit


# The forces of all frames of a recording: some frames together first, which tell what all share, then the others.

LEVEL = 0.95
TOUCH = float(chdtri(2, 1.0 - LEVEL))
_FEW = 24  # frames that are taken together: so far apart that the tags' errors are each one's own
MOVED = 0.2  # of the largest displacement of the tags: frames that move less tell the bench nothing
_ODD = 5.0  # times the usual squared residual: such a frame has a wrong tag, and tells the bench nothing either
_SCAN = np.linspace(0.2, 1.0, 9)  # places where the search for the contact begins
_AS_WELL = float(chdtri(1, 1.0 - LEVEL))  # of the objective: two places explain a frame about as well
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
    out[known] = np.einsum("tc,tc->t", found.force[known], solved) > chdtri(n, 1.0 - LEVEL)
    return out


def _together(bench: Bench, frames: IntArray) -> IntArray:
    """Which of the frames tell the bench: evenly spread among those in which the tags moved."""
    moved = np.nan_to_num(moved_by(bench.observations)[frames])
    rows = np.flatnonzero(moved >= MOVED * np.max(moved))
    return np.asarray(rows[np.linspace(0, len(rows) - 1, min(_FEW, len(rows))).astype(int)])


def first(bench: Bench, frames: IntArray, place: Array | None, prior_sd: Array) -> tuple[Estimates, Array]:
    """Each frame by itself, and another place that does about as well."""
    if place is not None:
        return estimate(bench, frames, place, prior_sd, seek_place=False), np.full(len(frames), np.nan)
    return _at_unknown_place(bench, frames, prior_sd)


def _at_unknown_place(bench: Bench, frames: IntArray, prior_sd: Array) -> tuple[Estimates, Array]:
    """From the place of a scan that explains a frame best; and (F,) another that does about as well, NaN: none."""
    roughly = partial(estimate, seek_place=False, restarts=0, tolerances=_TOLERANCES[:1])
    scan = [roughly(bench, frames, np.full(len(frames), s), prior_sd) for s in _SCAN]
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
