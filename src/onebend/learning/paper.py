"""The paper's own method: inverse kinematics (22), regression (12)-(18), selection (19)-(20)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from onebend.beam import grid
from onebend.beam.model import Beam
from onebend.beam.statics import Equilibrium
from onebend.beam.stiffness import Gaussians, Powers, Profile, by_legendre, equidistant, gaussian_basis, power_basis
from onebend.errors import LearningError, MechanicsError
from onebend.gauss_newton import Linearised, SearchLimits, most_probable
from onebend.learning import frames as framing
from onebend.learning.fit_data import AtRest, at_rest, beam_points
from onebend.learning.outcome import Comparison, Learned, Notice, Trial
from onebend.learning.parameters import NEEDS_MASS, weighs
from onebend.learning.validation import marker_misfit, validate
from onebend.options import option
from onebend.progress import Progress, Silent, one_blas_thread, track
from onebend.records import Array, BoolArray, IntArray, Observations, covariance_with_camera, left_of, unit

# Inverse kinematics (22) on all frames at once. Where a frame has fewer data than states, the shape of least curvature
# is taken.

_SETTLED = 1e-6  # posterior sds, of the last step
_LEAST_CURVATURE = 1e-3  # weight of the curvature energy against whitened data (a prior sd of about 30 rad)


@dataclass(frozen=True)
class States:
    """Legendre states of every frame; NaN where a frame has no tag."""

    modes: grid.Modes
    theta: Array  # (T, n) rad
    covariance: Array  # (T, n, n) rad^2, from the tags' covariances
    theta0: Array  # (n,) rad, at rest
    rest: AtRest
    data: Array  # (T,) measured numbers in the frame (3 a tag, or 2 without angles)
    converged: BoolArray  # (T,)


def solve_states(
    observations: Observations, n: int, *, with_angles: bool = True, rest: AtRest | None = None, most: int = 40
) -> States:
    """States of n Legendre modes for all T frames.

    Raises:
        LearningError: n is more than the tags can tell (3 a tag, 2 a tag without angles).
    """
    tags = len(observations.marker_s)
    limit = (3 if with_angles else 2) * tags
    if not 1 <= n <= limit:
        raise LearningError(f"n = {n} curvature modes, but {tags} tags can tell at most {limit}; choose n <= {limit}")
    rest = at_rest(observations) if rest is None else rest
    xy, tangent = beam_points(observations, rest)
    measured = np.concatenate([xy, tangent[..., None]], axis=-1)  # (T, m, 3)
    used = measured * np.array([1.0, 1.0, 1.0 if with_angles else np.nan])
    whiten = framing.whitening(used, covariance_with_camera(observations))
    data = np.asarray(np.sum(np.any(whiten != 0.0, axis=-1), axis=-1, dtype=float))  # (T, m)
    target = np.where(np.isfinite(measured), measured, 0.0)
    at = grid.places(observations.length, grid.Modes(n), observations.marker_s)
    sd = np.sqrt((2.0 * np.arange(n) + 1.0) / _LEAST_CURVATURE)  # `int q^2 = sum theta_i^2 / (2 i + 1)`

    def linearise(rows: IntArray, theta: Array, _: Array) -> Linearised:
        pose = np.concatenate([grid.positions(at, theta), grid.angles(at, theta)[..., None]], axis=-1)
        turn = np.broadcast_to(at.to_places[None, :, None, :], (len(rows), len(at.s), 1, n))
        slopes = np.concatenate([grid.jacobians(at, theta), turn], axis=2)
        both = framing.whitened(whiten[rows], np.concatenate([slopes, (target[rows] - pose)[..., None]], axis=-1))
        return Linearised(both[..., -1], both[..., :-1], np.ones(len(rows), dtype=bool), np.zeros((len(rows), 0)))

    theta = _start(at, target, data > 0, whiten)
    begin = linearise(np.arange(len(theta)), theta, theta)
    limits = SearchLimits(steps=most, tolerance=_SETTLED, damping=1e-3)
    found = most_probable(linearise, begin, theta, np.zeros(n), sd, limits)
    theta, seen, root = found.x.copy(), np.any(data > 0, axis=1), found.root
    theta[~seen] = np.nan
    return States(
        modes=grid.Modes(n),
        theta=theta,
        covariance=root @ np.swapaxes(root, 1, 2),
        theta0=rest.states(n),
        rest=rest,
        data=np.sum(data, axis=1),
        converged=found.converged & seen,
    )


def _start(at: grid.Places, target: Array, seen: BoolArray, whiten: Array) -> Array:
    """A first guess from angles: of the tags where used, of the chords between neighbouring tags otherwise.

    theta = 0 is a singular start (no curvature direction is preferred by positions on a straight beam).
    """
    if np.any(whiten[..., 2, 2] > 0.0):
        rows, values = at.to_places, target[..., 2]
    else:
        s = np.concatenate([[0.0], at.s])
        steps = np.diff(target[..., :2], axis=1, prepend=np.zeros((len(target), 1, 2)))
        values = np.unwrap(np.arctan2(steps[..., 1], steps[..., 0]), axis=1)
        rows = at.modes.angle(0.5 * (s[1:] + s[:-1]))
    weight = seen.astype(float)
    normal = np.einsum("tm,mi,mj->tij", weight, rows, rows) + 1e-3 * np.eye(at.modes.n)
    return np.asarray(np.linalg.solve(normal, np.einsum("tm,mi,tm->ti", weight, rows, values)[..., None])[..., 0])


# The paper's regression (12)-(18): `X gamma = Y`, linear in the coefficients gamma of k(s). For frame t and test
# function phi_j: sum_w gamma_w int Pi_w (q - q0) phi_j ds = (J(s_a)^T F)_j (+ the weight's share). Solved by an
# orthogonal decomposition. The paper's test functions are powers of s, unweighted; "regression" weights the rows by
# their noise.

Family = Literal["gaussians", "powers"]
_GRID = grid.make_grid(order=32)  # integrates polynomials up to degree 63 exactly
_ROUNDING = 1e-9  # of a spectrum that adds up to the number of rows: below lies rounding, not knowledge


@dataclass(frozen=True)
class MomentRows:
    """Rows of `X gamma = Y` before a family is chosen; Q nodes on the beam, test functions in Legendre form."""

    elastic: Array  # (T, n, Q): weight times (q - q0) phi_j at the nodes; X = elastic @ Pi
    load: Array  # (T, n): Y
    load_per_force: Array  # (T, n, 2): J(s_a)
    geometric: Array  # (T, n, n): the load's part of the equilibrium's tangent
    states: States


def assemble(observations: Observations, states: States) -> MomentRows:
    """Rows of all T frames (NaN where a frame has no states). Equations (9)-(11)."""
    on, modes, length = _GRID, states.modes, observations.length
    phi, a = modes.curvature(on.nodes), modes.angle(on.nodes)  # (Q, n)
    q = (states.theta - states.theta0) @ phi.T
    elastic = (on.weights * q)[:, None, :] * phi.T
    alpha = states.theta @ a.T
    u = unit(alpha)  # (T, Q, 2)
    across = left_of(u)
    to_push = on.integral_to(framing.push_places(observations)[:, None])[:, 0]  # (T, Q)
    load_per_force = length * np.einsum("tq,tqc,qi->tic", to_push, across, a, optimize=True)
    beyond = _weight_beyond(observations)  # (T, Q, 2)
    load = np.einsum("tic,tc->ti", load_per_force, observations.force)
    load = load + length * np.einsum("tqc,tqc,qi->ti", on.weights[:, None] * beyond, across, a, optimize=True)
    along = to_push * np.einsum("tqc,tc->tq", u, observations.force)
    along = along + on.weights * np.einsum("tqc,tqc->tq", u, beyond)
    geometric = length * np.einsum("tq,qi,qj->tij", along, a, a, optimize=True)
    return MomentRows(elastic, load, load_per_force, geometric, states)


def basis(family: Family, m: int, width: float | None) -> tuple[Array, float]:
    """Functions Pi_w at the nodes (Q, m), and the Gaussians' width (the distance of their centres if not given)."""
    if family == "powers":
        return power_basis(_GRID.nodes, m), np.nan
    sigma = (1.0 / max(m - 1, 1)) if width is None else width
    return gaussian_basis(_GRID.nodes, equidistant(m), sigma), sigma


def profile(family: Family, coefficients: Array, sigma: float) -> Profile:
    """k(s) of the coefficients."""
    gamma = tuple(float(c) for c in coefficients)
    return Powers(gamma) if family == "powers" else Gaussians(equidistant(len(gamma)), sigma, gamma)


def literal(rows: MomentRows, use: BoolArray, pi: Array) -> tuple[Array, float]:
    """gamma (m,) of (18) with the paper's rows: powers as test functions, no weights; and the condition of X."""
    return _orthogonal(*literal_rows(rows, use, pi))


def literal_rows(rows: MomentRows, use: BoolArray, pi: Array) -> tuple[Array, Array]:
    """X (R, m) and Y (R,) as the paper writes them, with powers of s as test functions; n rows a frame."""
    to_legendre = grid.powers_to_legendre(rows.states.modes.n)
    x = np.einsum("lj,tlq,qw->tjw", to_legendre, rows.elastic[use], pi, optimize=True).reshape(-1, pi.shape[1])
    return x, (rows.load[use] @ to_legendre).ravel()


def weighted(rows: MomentRows, use: BoolArray, pi: Array, *, force_sd: Array, rounds: int = 8) -> tuple[Array, float]:
    """gamma (m,) with each frame's rows weighted by the covariance that noise gives them; and the condition of X.

    The covariance depends on gamma through the tangent, so a few rounds of reweighting are made from a start that
    uses the load's noise alone.
    """
    elastic, load = rows.elastic[use] @ pi, rows.load[use]
    jacobian, geometric = rows.load_per_force[use], rows.geometric[use]
    spread = rows.states.covariance[use]
    phi = rows.states.modes.curvature(_GRID.nodes)
    from_force = (jacobian * force_sd**2) @ np.swapaxes(jacobian, 1, 2)
    gamma, condition = _orthogonal(elastic.reshape(-1, pi.shape[1]), load.ravel())
    for _ in range(rounds):
        k = np.maximum(pi @ gamma, 0.05 * np.mean(np.abs(pi @ gamma)))  # weights need a positive stiffness
        tangent = (phi.T * (_GRID.weights * k)) @ phi + geometric
        covariance = tangent @ spread @ np.swapaxes(tangent, 1, 2) + from_force
        sd = np.sqrt(np.einsum("tii->ti", covariance))
        # Rows are brought to one scale first: their variances differ by ten orders and more.
        whiten = _residual_whitening(covariance / (sd[:, :, None] * sd[:, None, :])) / sd[:, None, :]
        x = (whiten @ elastic).reshape(-1, pi.shape[1])
        y = (whiten @ load[..., None]).ravel()
        previous = gamma
        gamma, condition = _orthogonal(x, y)
        if np.max(np.abs(gamma - previous)) < 1e-9 * np.max(np.abs(gamma)):
            break
    return gamma, condition


def _residual_whitening(correlation: Array) -> Array:
    """(T, n, n) W: `W' W` is the inverse of each correlation matrix (T, n, n), eigenvalues bounded by `_ROUNDING`.

    A Cholesky factor is eight times faster than a spectrum; where its inverse is too large, the spectrum is used.
    """
    try:
        whiten = np.linalg.inv(np.linalg.cholesky(correlation))
    except np.linalg.LinAlgError:
        return _floored(correlation)
    low = ~(np.einsum("tij,tij->t", whiten, whiten) < 1.0 / _ROUNDING)
    if low.any():
        whiten[low] = _floored(correlation[low])
    return np.asarray(whiten)


def _floored(correlation: Array) -> Array:
    """As `_whitening`, by the spectra."""
    spectrum, vectors = np.linalg.eigh(correlation)
    return np.asarray(np.swapaxes(vectors / np.sqrt(np.maximum(spectrum, _ROUNDING))[:, None, :], 1, 2))


def _orthogonal(x: Array, y: Array) -> tuple[Array, float]:
    """Least squares by singular values with scaled columns; the condition number is that of the scaled matrix."""
    if not np.all(np.linalg.norm(x, axis=0) > 0.0):
        raise LearningError("a stiffness function meets no curvature at all: the beam did not bend there in any frame")
    solution, singular = least_squares(x, y)
    return solution, float(singular[0] / singular[-1]) if singular[-1] > 0.0 else np.inf


def column_sizes(x: Array) -> Array:
    """(m,) what each column is divided by before it is solved for; 1 for one of zeros."""
    sizes = np.linalg.norm(x, axis=0)
    return np.where(sizes > 0.0, sizes, 1.0)


def least_squares(x: Array, y: Array) -> tuple[Array, Array]:
    """Solution (m,) with columns brought to one size, and the singular values of the matrix so scaled."""
    scale = column_sizes(x)
    solution, _, _, singular = np.linalg.lstsq(x / scale, y, rcond=None)
    return np.asarray(solution / scale), np.asarray(singular)


def _weight_beyond(observations: Observations) -> Array:
    """(T, Q, 2) N: the weight of the beam beyond each node, its mass spread as it is written down."""
    if not weighs(observations):
        return np.zeros((len(observations.time), len(_GRID.nodes), 2))
    if not np.isfinite(observations.stated.mass):
        raise LearningError(f"{observations.source.name}: {NEEDS_MASS}")
    line = observations.length * np.asarray(framing.mass_profile(observations)(_GRID.nodes))
    beyond = _GRID.weights @ line - grid.apply(_GRID.integral_to_nodes, line)
    for one in observations.stated.masses:
        beyond = beyond + one.mass * (_GRID.nodes < one.s)
    return np.asarray(beyond[None, :, None] * observations.gravity[:, None, :])


Method = Literal["regression", "paper"]
Bic = Literal["textbook", "paper"]
_SNAPS = "the learned beam snaps through under the measured forces"
_FINE = np.linspace(0.0, 1.0, 401)
MOST_FRAMES = 1000  # that a trial is learned from, evenly spread
_SIMULATED = 50  # frames that it is compared in: the markers' RMS of a push is the same in fifty of it as in all


@dataclass(frozen=True)
class RegressionSettings:
    """How k(s) is learned from states and forces."""

    method: Method = "regression"  # "paper": the literal rows of (17), tags' positions only
    family: Family = option("--family", "gaussians")
    width: float | None = option("--width", None, metavar="SIGMA", within=(0.001, 1e9))
    bic: Bic = option("--bic", "textbook")
    n: int | None = option("--n", None, metavar="N")
    m: int | None = option("--m", None)
    most_n: int | None = None  # the paper's z; None: all that the tags can tell, at most 8

    @property
    def with_angles(self) -> bool:
        """Whether the tags' angles are used; the paper had positions only."""
        return self.method != "paper"


@dataclass(frozen=True)
class Candidate:
    """One trial with what it takes to go on from it."""

    trial: Trial
    beam: Beam | None
    solved: Equilibrium | None = None  # where it was simulated


def pairs(settings: RegressionSettings, tags: int) -> list[tuple[int, int]]:
    """All (n, m) to try (20): n in 2..z, m in 2..n. Raises `LearningError` on a fixed n or m that cannot be."""
    limit = (3 if settings.with_angles else 2) * tags
    z = min(limit, 8) if settings.most_n is None else settings.most_n
    if z > limit:
        raise LearningError(f"most_n = {z}, but {tags} tags can tell at most {limit} modes")
    if settings.n is not None and not 2 <= settings.n <= limit:
        raise LearningError(f"n = {settings.n}, but {tags} tags can tell 2 to {limit} modes")
    found = [
        (n, m)
        for n in ([settings.n] if settings.n else range(2, z + 1))
        for m in ([settings.m] if settings.m else range(2, n + 1))
        if m <= n
    ]
    if not found:
        raise LearningError(f"m = {settings.m} stiffness functions need at least as many modes; raise n or lower m")
    return found


def information_criterion(rms: Array, observed: int, parameters: int, kind: Bic) -> float:
    """BIC of a model with markers' `rms` (m,) over `observed` numbers (19).

    textbook: `N ln(RSS / N) + k ln N` with RSS the sum of squares. paper: `ln(sqrt(sum M_i^2)) + 10`, which is what its
    printed Table II follows to rounding (its complexity term is below what the table can show).
    """
    norm = float(np.sqrt(np.sum(rms**2)))
    if kind == "paper":
        return float(np.log(norm) + 10.0)
    mean_square = norm**2 / (2 * len(rms))
    return float(observed * np.log(mean_square) + parameters * np.log(observed))


def table(
    observations: Observations,
    rest: AtRest,
    settings: RegressionSettings,
    progress: Progress,
    most_frames: int = MOST_FRAMES,
) -> list[Candidate]:
    """Every (n, m): learned from at most `most_frames`, simulated and compared in at most 51 of them.

    Raises:
        LearningError: the frames are too few for any.
    """
    observations = _fewer(observations, most_frames)
    frames = framing.usable_frames(observations)
    wanted = pairs(settings, len(observations.marker_s))
    needed = max(n + m for n, m in wanted)
    if still := framing.nothing_moves(observations):
        raise LearningError(f"{observations.source.name}: {still}. Film a push, and let the force log cover it")
    if np.sum(frames) < needed:
        raise LearningError(
            f"{observations.source.name}: {np.sum(frames)} loaded frames, but up to {needed} parameters are to be "
            "found; film a longer push, or fix smaller n and m"
        )
    out: list[Candidate] = []
    states: States | None = None
    compared = _compared(observations, frames)
    near: Equilibrium | None = None
    for n, m in track(progress, "trying (n, m)", wanted, len(wanted)):
        if states is None or states.modes.n != n:
            states = solve_states(observations, n, with_angles=settings.with_angles, rest=rest)
            rows = assemble(observations, states)
        use = frames & states.converged & (states.data >= n)
        out.append(_try(observations, rows, use, compared, near, m, settings))
        near = out[-1].solved or near
    return out


def _fewer(observations: Observations, most: int) -> Observations:
    """At most so many of the usable frames of a film."""
    frames = np.flatnonzero(framing.usable_frames(observations)).astype(np.int64)
    if observations.static or len(frames) <= most:
        return observations
    return framing.at_frames(observations, framing.evenly_spread(frames, most, len(observations.time)))


def _compared(observations: Observations, frames: BoolArray) -> BoolArray:
    """(T,) some fifty of the frames, and that of the largest force: there a beam snaps through first."""
    if observations.static:
        return frames
    rows = np.flatnonzero(frames).astype(np.int64)
    chosen = framing.evenly_spread(rows, _SIMULATED, len(frames))
    chosen[rows[np.argmax(framing.distances(observations.force[rows]))]] = True
    return chosen


def choose(candidates: list[Candidate]) -> int:
    """Index of the lowest BIC. Raises `LearningError` where no trial gave a beam that can stand."""
    bic = np.array([c.trial.bic for c in candidates])
    if not np.any(np.isfinite(bic)):
        worst = "; ".join(f"n={c.trial.n}, m={c.trial.m}: {c.trial.why_out}" for c in candidates[:3])
        raise LearningError(
            f"no (n, m) gave a beam that can be simulated ({worst}; ...). The force or the tags contradict the bending "
            "of a beam: check the force's sign and axes, the clock and the tags' places"
        )
    return int(np.argmin(bic))


def standing(candidates: list[Candidate], observations: Observations, rest: AtRest) -> tuple[int, Comparison]:
    """The trial of lowest BIC with an equilibrium in all frames, and its comparison; others get an infinite BIC."""
    while True:
        chosen = choose(candidates)
        best = candidates[chosen]
        assert best.beam is not None
        training = validate(best.beam, observations, rest=rest)
        if np.all(np.isfinite(training.predicted)):
            return chosen, training
        candidates[chosen] = replace(best, trial=replace(best.trial, bic=np.inf, why_out=_SNAPS))


def _try(
    observations: Observations,
    rows: MomentRows,
    use: BoolArray,
    compared: BoolArray,
    near: Equilibrium | None,
    m: int,
    settings: RegressionSettings,
) -> Candidate:
    """Learn one (n, m) from frames `use` (T,), simulate it in `compared` (T,); `near`: another trial's shapes."""
    n = rows.states.modes.n
    pi, sigma = basis(settings.family, m, settings.width)
    trial = Trial(n, m, np.full(m, np.nan), np.full(len(observations.marker_s), np.nan), np.inf, np.nan, np.inf)
    if np.sum(use) < n + m:
        return Candidate(replace(trial, why_out=f"only {np.sum(use)} frames show enough tags"), None)
    if settings.method == "paper":
        gamma, condition = literal(rows, use, pi)
    else:
        gamma, condition = weighted(rows, use, pi, force_sd=observations.force_sd)
    stiffness = profile(settings.family, gamma, sigma)
    lowest = float(np.min(stiffness(_FINE)))
    trial = replace(trial, coefficients=gamma, lowest_k=lowest, condition=condition)
    if not lowest > 0.0:
        where = float(_FINE[np.argmin(stiffness(_FINE))])
        return Candidate(replace(trial, why_out=f"k is {lowest:.2g} N m at s = {where:.2f}"), None)
    beam = make_beam(observations, rows.states, stiffness)
    try:
        rms, solved = marker_misfit(beam, observations, compared, rows.states.rest, near)
    except MechanicsError as error:
        return Candidate(replace(trial, why_out=str(error)), None)
    seen = np.isfinite(rms)
    if not seen.any():
        return Candidate(replace(trial, why_out=_SNAPS), beam)
    observed = int(np.sum(np.isfinite(observations.xy[framing.usable_frames(observations)])))
    bic = information_criterion(rms[seen], observed, n + m, settings.bic)
    return Candidate(replace(trial, rms=rms, bic=bic), beam, solved)


def make_beam(observations: Observations, states: States, stiffness: Profile) -> Beam:
    """The learned beam: stiffness, rest curvature and the mass as it is written down."""
    return Beam(
        observations.length,
        stiffness,
        rest_curvature=by_legendre(states.theta0),
        mass_per_length=framing.mass_profile(observations),
        masses=observations.stated.masses,
    )


@one_blas_thread
def regress(
    observations: Observations,
    settings: RegressionSettings = RegressionSettings(),
    *,
    most_frames: int = MOST_FRAMES,
    progress: Progress = Silent(),
) -> Learned:
    """The stiffness distribution of the observed beam, from at most so many frames.

    Raises:
        LearningError: too few loaded frames, or no (n, m) gives a beam that can be simulated.
    """
    observations = framing.read_alone(observations)
    rest = at_rest(observations)
    candidates = table(observations, rest, settings, progress, most_frames)
    chosen, training = standing(candidates, observations, rest)
    beam = candidates[chosen].beam
    assert beam is not None  # its BIC is finite
    return Learned(
        beam=beam,
        method=settings.method,
        family=settings.family,
        trials=tuple(c.trial for c in candidates),
        chosen=chosen,
        training=training,
        remarks=(*_rest_notices(rest, observations), *training.remarks),
    )


def _rest_notices(rest: AtRest, observations: Observations) -> tuple[Notice, ...]:
    """Assumptions about the beam at rest."""
    if not rest.seen:
        return (Notice("rest not seen"),)
    shift = float(np.max(np.linalg.norm(rest.offset, axis=1)))
    code = "tags off far at rest" if shift > 4.0 * observations.stated.placement_sd else "tags off at rest"
    return (Notice(code, {"shift": shift, "turn": float(np.max(np.abs(rest.turn)))}),)
