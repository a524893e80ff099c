"""What the log must have been if the markers are right: the force from the turns of the spans between the tags.

The turn of a span is `F . integral of w(s) a(s) ds` with w = 1 / k the compliance along it and a the lever of a unit
force about s: exact for a beam that moves slowly, and linear in F. In w only what the span's levers show counts, its
mean and its slope. With tags whose turns have a noise of their own, the force of a frame is normal about an estimate;
its spread is wide where the spans say little, as along a straight beam. So every row of the log is normal about that
estimate too, with its own noise beside (`noise.py`), and with an error that changes where the load does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_triangular
from scipy.optimize import minimize, nnls

from onebend.recording.clock_rows import Rows
from onebend.recording.relation import SHORTEST_SPAN, TOUCHED, Track, along, is_still, lasting
from onebend.recording.load_stages import displacement, load_changes
from onebend.recording.signals import MAD_TO_SD, bridged
from onebend.records import DIRECTION_SD, PLACE_SD, Array, ForceNoise, Markers

JUMP = 8.0  # robust sd, of a pose that is read wrongly
HEAVY = 4.0  # degrees of freedom of Student's t: some tags are read wrongly
ROUNDS = 12
TYPICAL, LARGE = 0.01, 0.1  # of the largest force: a log's error changes by about, and may change by
NODES = 5  # Gauss, on a span
SLOPE = 1.0  # prior sd of the slope of the compliance over half a span, of its mean (3 times how far its centre lies off)
FREE_SCALE = 1.0  # prior sd of the log of a span's compliance
FREE = 10.0  # of the largest force: prior sd of the log's bias
SLACK = 0.2  # s, that a change of the load may show earlier or later in the log
STILL = 10  # first frames, whose angles are the ones at rest


@dataclass(frozen=True)
class Moments:
    """Turns and levers of k spans in time, to be averaged over any span of time."""

    track: Track  # features (k, 5): turn, mean of the lever, its first Legendre moment
    tangent: Track  # (2,), what a push that acts farther on adds to all levers
    steps: Track  # (n,), ramps over the changes of the load
    noise: Array  # (k,) rad, of a turn
    largest: Array  # (k,) rad


@dataclass(frozen=True)
class Seen:
    """Moments at N rows."""

    turn: Array  # (N, k)
    lever: Array  # (N, 2 moments, k, 2)
    tangent: Array  # (N, 2)
    steps: Array  # (N, n)


def make_moments(markers: Markers, *, push_s: float, longest_gap: float, hold: float) -> Moments | None:
    kept, covered = lasting(markers, longest_gap)
    if not kept.any():
        return None
    time, count = markers.time, len(markers.time)
    markers = without_jumps(markers)
    xy = bridged(time, markers.xy[:, kept].reshape(count, -1)).reshape(count, -1, 2)
    angle = bridged(time, markers.angle[:, kept])
    s = np.concatenate([[0.0], markers.s[kept]])
    order = np.argsort(s, kind="stable")
    full = np.concatenate([np.zeros((count, 1, 2)), xy], axis=1)[:, order]
    turned = np.concatenate([np.zeros((count, 1)), angle], axis=1)[:, order]
    s = s[order]
    spans = np.flatnonzero((s[:-1] < push_s - SHORTEST_SPAN) & (np.diff(s) > 1e-6))
    bend = turned - np.median(turned[:STILL], axis=0)
    turns = bend[:, spans + 1] - bend[:, spans]
    largest = np.abs(turns).max(axis=0, initial=0.0)
    moved = largest > 0.02 * largest.max(initial=0.0)
    if not moved.any():
        return None
    spans, turns, largest = spans[moved], turns[:, moved], largest[moved]
    push = along(full, turned, s, push_s)
    back = along(full, turned, s, push_s - 0.02)
    tangent = (push - back) / np.linalg.norm(push - back, axis=1, keepdims=True)
    x, weight = np.polynomial.legendre.leggauss(NODES)
    ends = np.minimum(s[spans + 1], push_s)
    lever = np.zeros((2, count, len(spans), 2))
    for at, part in zip(x, 0.5 * weight, strict=True):
        places = s[spans] + 0.5 * (at + 1.0) * (ends - s[spans])
        arm = push[:, None] - np.stack([along(full, turned, s, place) for place in places], axis=1)
        lever += part * np.array([1.0, at])[:, None, None, None] * np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
    features = np.concatenate([turns[..., None], lever[0], lever[1]], axis=-1)
    flat = xy.reshape(count, -1)
    before, after = (hold if is_still(flat, rows) else 0.0 for rows in (slice(0, 10), slice(-10, None)))

    def track(values: Array) -> Track:
        return Track(CubicSpline(time, values, axis=0).antiderivative(), covered, time, before, after)

    jumps = np.diff(turns, n=2, axis=0)
    noise = MAD_TO_SD * np.median(np.abs(jumps), axis=0) / np.sqrt(6.0)
    return Moments(
        track(features),
        track(np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)),
        track(own_times(time, xy)),
        np.maximum(noise, 1e-3 * largest),
        largest,
    )


def without_jumps(markers: Markers) -> Markers:
    """Markers without single frames that lie far off the cubic through the two before and the two after."""
    state = np.concatenate([markers.xy, markers.angle[..., None]], axis=-1)
    if len(state) < 9:
        return markers
    off = np.zeros_like(state)
    off[2:-2] = state[2:-2] - (4 * (state[1:-3] + state[3:-1]) - state[:-4] - state[4:]) / 6
    size = np.abs(off) / np.maximum(MAD_TO_SD * np.nanmedian(np.abs(off), axis=0), np.finfo(float).tiny)
    size = np.nan_to_num(size).max(axis=-1)
    peak = np.maximum(np.roll(size, 1, axis=0), np.roll(size, -1, axis=0)) <= size
    state[(size > JUMP) & peak] = np.nan
    return replace(markers, xy=state[..., :2], angle=state[..., 2])


def own_times(time: Array, xy: Array) -> Array:
    """(T, n) from 0 to 1 over each change of the load: the time of the random walk that a log's error makes there."""
    size = displacement(time, xy, np.median(xy[:STILL], axis=0))
    changes = load_changes(time, size, size > TOUCHED * size.max())
    wide = [replace(each, begin=each.begin - SLACK, end=each.end + SLACK) for each in changes]
    return np.asarray(np.stack([np.zeros(len(time)), *(each.part(time) for each in wide)], axis=1)[:, 1:])


def seen_at(moments: Moments, centre: Array, width: float) -> Seen:
    f = moments.track.mean(centre, width)
    return Seen(
        f[..., 0],
        np.stack([f[..., 1:3], f[..., 3:5]], axis=1),
        moments.tangent.mean(centre, width),
        np.clip(moments.steps.mean(centre, width), 0.0, 1.0),
    )


def rough_compliance(seen: Seen, force: Array) -> tuple[Array, float, Array]:
    """(k,) rad / (N m) mean compliance of every span, the log's sign, and its bias (2,) N with that sign.

    Least squares with stiffnesses that are not negative: convex, so that nothing runs off.
    """
    count, spans = seen.turn.shape
    lever = seen.lever[:, 0]
    ridge = 0.01 * float((lever**2).sum(axis=-1).max())
    inner = np.einsum("nka,nkb->nab", lever, lever) + ridge * np.eye(2)
    part = np.linalg.solve(inner, lever.transpose(0, 2, 1)) * seen.turn[:, None, :]
    axes = np.tile(np.eye(2), (count, 1))
    design = np.hstack([part.reshape(2 * count, spans), axes, -axes])
    size = np.linalg.norm(design, axis=0)
    found = {sign: nnls(design / size, sign * force.ravel()) for sign in (1.0, -1.0)}
    sign = min(found, key=lambda each: float(found[each][1]))
    stiffness = found[sign][0] / size
    bias = stiffness[spans : spans + 2] - stiffness[spans + 2 :]
    alike = nnls(np.hstack([design[:, :spans].sum(axis=1, keepdims=True), axes, -axes]), sign * force.ravel())[0][0]
    stiffness = np.maximum(stiffness[:spans], 0.1 * max(alike, np.finfo(float).tiny ** 0.25))
    return 1.0 / stiffness, sign, bias


@dataclass(frozen=True)
class Model:
    """Mean of the log at N rows, as a function of p standard normal parameters."""

    moments: Moments
    compliance: Array  # (k,) rad / (N m), about which the parameters are
    force: float  # N, largest
    length: float = 1.0

    @property
    def count(self) -> int:
        return 3 * len(self.compliance) + 4

    def matrix(self, seen: Seen, z: Array) -> Array:
        k = len(self.compliance)
        w = self.compliance * np.exp(FREE_SCALE * z[:k])
        lever = seen.lever[:, 0] + PLACE_SD * z[2 * k] * seen.tangent[:, None, :]
        return np.asarray((lever + SLOPE * z[k : 2 * k, None] * seen.lever[:, 1]) * w[:, None])

    def told(self, seen: Seen, z: Array) -> tuple[Array, Array]:
        """(N, 2) N and (N, 2, 2) N^2: mean and covariance of the force on the beam."""
        k = len(self.compliance)
        a = self.matrix(seen, z)
        weight = 1.0 / self.moments.noise**2
        rest = self.moments.noise / np.sqrt(STILL)
        size = np.sqrt(np.mean((seen.turn / self.moments.noise) ** 2, axis=1) + 1.0)
        size *= self.force / np.sqrt(np.mean((self.moments.largest / self.moments.noise) ** 2))
        inner = np.einsum("nia,i,nib->nab", a, weight, a) + np.eye(2) / size[:, None, None] ** 2
        spread = np.linalg.inv(inner)
        turn = seen.turn - rest * z[2 * k + 4 :]
        return np.einsum("nab,nib,i,ni->na", spread, a, weight, turn), spread

    def misfit(self, seen: Seen, z: Array) -> Array:
        """(N, k) sd that the turns are off what one force a row would make."""
        k = len(self.compliance)
        force, _ = self.told(seen, z)
        rest = self.moments.noise / np.sqrt(STILL) * z[2 * k + 4 :]
        return np.asarray((seen.turn - rest - np.einsum("nia,na->ni", self.matrix(seen, z), force)) / self.moments.noise)

    def mean(self, seen: Seen, z: Array) -> Array:
        k = len(self.compliance)
        force, _ = self.told(seen, z)
        turned = DIRECTION_SD * z[2 * k + 1] * np.stack([-force[:, 1], force[:, 0]], axis=1)
        return np.asarray(force + turned + FREE * self.force * z[2 * k + 2 : 2 * k + 4])


def jacobian(function: Callable[[Array], Array], z: Array, base: Array) -> Array:
    out = np.empty((base.size, len(z)))
    for i in range(len(z)):
        step = np.zeros(len(z))
        step[i] = 1e-4
        out[:, i] = (function(z + step) - base).ravel() / 1e-4
    return out


def covariance(noise: ForceNoise, time: Array, spread: Array, jumps: Array) -> Array:
    """(2N, 2N) N^2 of the log about its mean, rows of both axes in turn."""
    n = len(time)
    done = np.cumsum(jumps)
    one = noise.covariance(time) + np.minimum(done[:, None], done)
    out = np.zeros((n, 2, n, 2))
    out[:, 0, :, 0] = out[:, 1, :, 1] = one
    at = np.arange(n)
    out[at, :, at, :] += spread
    return np.asarray(out.reshape(2 * n, 2 * n))


def tied(model: Model, film: Seen, z: Array) -> tuple[float, Array, Array]:
    """What the film alone says of the parameters: minus its log chance (Student's t a row), minus slope, curvature."""
    base = model.misfit(film, z)
    j = jacobian(lambda x: model.misfit(film, x), z, base).reshape(*base.shape, len(z))
    free = base.shape[1]
    size = np.sum(base**2, axis=1) / HEAVY
    weight = (1.0 + free / HEAVY) / (1.0 + size)
    cost = 0.5 * (HEAVY + free) * float(np.sum(np.log1p(size)))
    return cost, -np.einsum("nip,ni,n->p", j, base, weight), np.einsum("nip,niq,n->pq", j, j, weight)


def evidence(
    model: Model, seen: Seen, film: Seen, force: Array, root: Array, z: Array, rounds: int
) -> tuple[float, Array]:
    """Laplace's log evidence and the likeliest parameters."""
    def step(z: Array) -> tuple[float, Array, Array]:
        base = model.mean(seen, z)
        columns = np.column_stack([jacobian(lambda x: model.mean(seen, x), z, base), (force - base).ravel()])
        white = solve_triangular(root, columns, lower=True, check_finite=False)
        j, r = white[:, :-1], white[:, -1]
        cost, slope, inner = tied(model, film, z)
        return cost + 0.5 * float(r @ r + z @ z), inner + np.eye(len(z)) + j.T @ j, slope + j.T @ r - z

    value, inner, slope = step(z)
    damping = 0.0
    for _ in range(rounds):
        move = np.linalg.solve(inner + damping * np.diag(np.diag(inner)), slope)
        if move @ slope < 0.01:
            break
        new = z + np.clip(move, -1.0, 1.0)
        cost = step(new)
        if cost[0] < value:
            z, (value, inner, slope), damping = new, cost, 0.1 * damping if damping > 1e-3 else 0.0
        else:
            damping = max(10.0 * damping, 0.1)
    return -value - 0.5 * float(np.linalg.slogdet(inner)[1]) - float(np.sum(np.log(np.diag(root)))), z


def around(model: Model, seen: Seen, film: Seen, force: Array, z: Array) -> tuple[Array, Array]:
    """The log less its mean, and what the parameters may add to that (2N, p): the film and their prior leave a normal
    distribution, and whatever lies in there the log may choose."""
    base = model.mean(seen, z)
    j = jacobian(lambda x: model.mean(seen, x), z, base)
    _, slope, inner = tied(model, film, z)
    root = np.linalg.cholesky(inner + np.eye(len(z)))
    half = solve_triangular(root, j.T, lower=True).T
    return (force - base).ravel() - half @ solve_triangular(root, slope - z, lower=True), half


def grown(seen: Seen) -> Array:
    """(N,) share of the changes of the load that lies between each row and the one before it."""
    return np.concatenate([[0.0], np.maximum(np.diff(seen.steps, axis=0), 0.0).sum(axis=1)])


def found_jumps(left: Array, free: Array, rest: Array, jumps: Array, typical: Array) -> Array:
    """(N,) N^2, from guessed `jumps`: variance of a change of the log's error before each row; `rest` (2N, 2N) N^2 is
    all else. Changes of the load come with Cauchy distributed ones of about `typical` (N,) N^2: expectation and
    maximisation over their variances, both axes together.
    """
    n = len(jumps)
    rows = np.kron(np.tril(np.ones((n, n))), np.eye(2))
    for _ in range(ROUNDS):
        size = np.repeat(jumps, 2)
        root = np.linalg.cholesky(rest + free @ free.T + (rows * size) @ rows.T)
        white = solve_triangular(root, np.column_stack([rows, left]), lower=True, check_finite=False)
        mean = size * (white[:, :-1].T @ white[:, -1])
        spread = size - size**2 * np.sum(white[:, :-1] ** 2, axis=0)
        jumps = (typical + (mean**2 + spread).reshape(n, 2).sum(axis=1)) / 3.0 * (typical > 0.0)
    return np.asarray(jumps)


def fitted_noise(
    left: Array, free: Array, time: Array, spread: Array, start: ForceNoise, jumps: Array
) -> tuple[ForceNoise, float]:
    """The likeliest noise around a linear model."""
    scale = np.log(np.array([5.0, 5.0, 2.5, 5.0]))
    centre = np.log(np.array([start.white, start.coloured, start.tau, start.walk]))

    def sized(x: Array) -> ForceNoise:
        white, coloured, tau, walk = np.exp(centre + scale * x).tolist()
        return replace(start, white=white, coloured=coloured, tau=tau, walk=walk)

    def unlikely(x: Array) -> float:
        root = np.linalg.cholesky(covariance(sized(x), time, spread, jumps))
        white = solve_triangular(root, np.column_stack([free, left]), lower=True, check_finite=False)
        a, b = white[:, :-1], white[:, -1]
        inner = np.linalg.cholesky(np.eye(free.shape[1]) + a.T @ a)
        told = solve_triangular(inner, a.T @ b, lower=True)
        fit = 0.5 * float(x @ x + b @ b - told @ told)
        return fit + float(np.sum(np.log(np.diag(root))) + np.sum(np.log(np.diag(inner))))

    simplex = np.vstack([np.zeros(4), 0.4 * np.eye(4)])
    options = {"maxfev": 100, "xatol": 0.05, "fatol": 0.05, "initial_simplex": simplex}
    found = minimize(unlikely, np.zeros(4), method="Nelder-Mead", options=options)
    return sized(found.x), -float(found.fun)
