"""How probable a force log is if the markers are right: a model of every row of it, and of its noise.

With tags whose turns have a noise of their own, the force of a frame is normal about an estimate; its spread is wide
where the spans say little, as along a straight beam (`span_moments.py`). So every row of the log is normal about that
estimate, with its own noise (`noise.py`) beside, and with an error that changes where the load does. What is not known
of the beam (compliances, the push's place, the axes) is held by two things: one force must explain all turns of a
frame, and the log must follow that force.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize, nnls

from onebend.recording.clock.polynomial_features import RIDGE
from onebend.recording.clock.span_moments import STILL, Moments, Seen
from onebend.records import DIRECTION_SD, PLACE_SD, Array, ForceNoise

SLOPE = 1.0  # prior sd of the slope of the compliance over half a span, of its mean: 3 times how far its centre is off
FREE_SCALE = 1.0  # prior sd of the log of a span's compliance about a first regression
FREE = 10.0  # of the largest force: prior sd of the log's bias
SOFTEST = 0.1  # of the stiffness that the largest force asks for: the least that a first regression may say
HEAVY = 4.0  # degrees of freedom of Student's t: some tags are read wrongly
FARTHEST = 6.0  # sd, of a parameter: what goes there does not come back
ROUNDS = 12  # of expectation and maximisation
DIFFERENCE = 1e-4  # step of the parameters for derivatives

# Minus a log chance of the parameters, minus its slope (p,), and its curvature (p, p)
Tie = Callable[[Array], tuple[float, Array, Array]]


def rough_compliance(seen: Seen, force: Array) -> tuple[Array, float, Array]:
    """(k,) rad / (N m) mean compliance of every span, the log's sign, and its bias (2,) N with that sign.

    Least squares with stiffnesses that are not negative: convex, so that nothing runs off.
    """
    count, spans = seen.turn.shape
    lever = seen.lever[:, 0]
    ridge = RIDGE * float((lever**2).sum(axis=-1).max())
    inner = np.einsum("nka,nkb->nab", lever, lever) + ridge * np.eye(2)
    part = np.linalg.solve(inner, lever.transpose(0, 2, 1)) * seen.turn[:, None, :]
    axes = np.tile(np.eye(2), (count, 1))
    design = np.hstack([part.reshape(2 * count, spans), axes, -axes])
    size = np.linalg.norm(design, axis=0)
    found = {sign: nnls(design / size, sign * force.ravel()) for sign in (1.0, -1.0)}
    sign = min(found, key=lambda each: float(found[each][1]))
    stiffness = found[sign][0] / size
    bias = stiffness[spans : spans + 2] - stiffness[spans + 2 :]
    # What the largest force would need to turn all spans as they turn: a first regression may find nothing at all.
    plain = np.abs(force - np.median(force, axis=0)).max() * np.sqrt((lever**2).sum(axis=-1).max(axis=0))
    plain /= np.abs(seen.turn).max(axis=0)
    stiffness = np.maximum(stiffness[:spans], SOFTEST * plain)
    return 1.0 / stiffness, sign, bias


@dataclass(frozen=True)
class Model:
    """Mean of the log at N rows, as a function of 3 k + 4 parameters z that are standard normal: logs of the spans'
    compliances, their slopes, the push's place, the log's direction and bias (2), and the spans' turns at rest. z may
    have leading axes; so has then what comes out."""

    moments: Moments
    compliance: Array  # (k,) rad / (N m), about which the parameters are
    force: float  # N, largest

    def start(self, bias: Array) -> Array:
        """(3 k + 4,) parameters with a bias (2,) [N] of the log."""
        k = len(self.compliance)
        z = np.zeros(3 * k + 4)
        z[2 * k + 2 : 2 * k + 4] = bias / (FREE * self.force)
        return z

    def matrix(self, seen: Seen, z: Array) -> Array:
        """(N, k, 2) rad / N, turns of the spans under a unit force."""
        k = len(self.compliance)
        w = self.compliance * np.exp(FREE_SCALE * z[..., :k])
        lever = seen.lever[:, 0] + PLACE_SD * z[..., 2 * k, None, None, None] * seen.tangent[:, None, :]
        return np.asarray((lever + SLOPE * z[..., None, k : 2 * k, None] * seen.lever[:, 1]) * w[..., None, :, None])

    def told(self, seen: Seen, z: Array) -> tuple[Array, Array]:
        """(N, 2) N and (N, 2, 2) N^2: mean and covariance of the force on the beam."""
        k = len(self.compliance)
        a = self.matrix(seen, z)
        weight = 1.0 / self.moments.noise**2
        rest = self.moments.noise / np.sqrt(STILL)
        size = np.sqrt(np.mean((seen.turn / self.moments.noise) ** 2, axis=1) + 1.0)
        size *= self.force / np.sqrt(np.mean((self.moments.largest / self.moments.noise) ** 2))
        weighed = a * weight[:, None]
        inner = np.swapaxes(weighed, -1, -2) @ a + np.eye(2) / size[:, None, None] ** 2
        (xx, xy), (_, yy) = np.moveaxis(inner, (-2, -1), (0, 1))
        spread = np.moveaxis(np.array([[yy, -xy], [-xy, xx]]) / (xx * yy - xy**2), (0, 1), (-2, -1))
        turn = seen.turn - rest * z[..., None, 2 * k + 4 :]
        pulled = np.einsum("...kc,...k->...c", weighed, turn)
        return np.einsum("...cd,...d->...c", spread, pulled), spread

    def misfit(self, seen: Seen, z: Array) -> Array:
        """(N, k) sd that the turns are off what one force a row would make."""
        k = len(self.compliance)
        force, _ = self.told(seen, z)
        rest = self.moments.noise / np.sqrt(STILL) * z[..., None, 2 * k + 4 :]
        made = np.einsum("...kc,...c->...k", self.matrix(seen, z), force)
        return np.asarray((seen.turn - rest - made) / self.moments.noise)

    def mean(self, seen: Seen, z: Array) -> Array:
        """(N, 2) N, the log's expectation."""
        k = len(self.compliance)
        force, _ = self.told(seen, z)
        turned = DIRECTION_SD * z[..., 2 * k + 1, None, None] * np.stack([-force[..., 1], force[..., 0]], axis=-1)
        return np.asarray(force + turned + FREE * self.force * z[..., None, 2 * k + 2 : 2 * k + 4])


def jacobian(function: Callable[[Array], Array], z: Array, base: Array) -> Array:
    """(n, p) derivatives of `function`, n numbers whose values at z are `base`; it takes all steps of z at once."""
    moved = function(z + DIFFERENCE * np.eye(len(z)))
    return np.asarray(((moved - base) / DIFFERENCE).reshape(len(z), -1).T)


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


def nearly(model: Model, film: Seen, z: Array) -> Tie:
    """`tied`, as a parabola about z."""
    cost, slope, inner = tied(model, film, z)

    def parabola(x: Array) -> tuple[float, Array, Array]:
        move = x - z
        bent = inner @ move
        return cost + float(move @ (0.5 * bent - slope)), slope - bent, inner

    return parabola


def evidence(
    model: Model, seen: Seen, tie: Tie, force: Array, root: Array, z: Array, rounds: int
) -> tuple[float, Array]:
    """Laplace's log evidence of `force` (N, 2) under noise of covariance root root', and the likeliest parameters."""

    def step(z: Array) -> tuple[float, Array, Array]:
        base = model.mean(seen, z)
        columns = np.column_stack([jacobian(lambda x: model.mean(seen, x), z, base), (force - base).ravel()])
        white = solve_triangular(root, columns, lower=True, check_finite=False)
        j, r = white[:, :-1], white[:, -1]
        cost, slope, inner = tie(z)
        return cost + 0.5 * float(r @ r + z @ z), inner + np.eye(len(z)) + j.T @ j, slope + j.T @ r - z

    value, inner, slope = step(z)
    damping = 0.0
    for _ in range(rounds):
        move = np.linalg.solve(inner + damping * np.diag(np.diag(inner)), slope)
        if move @ slope < 0.01:
            break
        new = np.clip(z + np.clip(move, -1.0, 1.0), -FARTHEST, FARTHEST)
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


def fitted_noise(left: Array, free: Array, time: Array, spread: Array, start: ForceNoise, jumps: Array) -> ForceNoise:
    """The likeliest noise of what is `left` (2N,) N of the log, of which `free` (2N, p) N times standard normal numbers
    may be the parameters'. As in `noise.fit_noise`, a weak prior about `start` keeps sizes from running off."""
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
    options = {"maxfev": 80, "xatol": 0.05, "fatol": 0.05, "initial_simplex": simplex}
    found = minimize(unlikely, np.zeros(4), method="Nelder-Mead", options=options)
    return sized(found.x)
