"""Observations drawn from the fit's own model, and the least variance that any estimator could have on them.

Everything is as the fit assumes: log k from its prior and the prior of that prior's sizes (or one fixed spline), clamp,
origin, clock, push and tags from their priors, the force's error from its process, white noise on tags and on every
frame's force. Only level and slope of log k, whose prior is all but flat, are drawn narrower: a flat prior does not
care. So the band must hold the truth as often as it says, if what the fit does with its model is right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.stiffness import LogSpline
from onebend.lab.bench import ForceSensor, PushProfile
from onebend.lab.designs import force_that_bends
from onebend.lab.virtual import VirtualBench, virtual_recording
from onebend.learning.allowances import EVERY_ALLOWANCE
from onebend.learning.fit_data import FitData, fit_data
from onebend.learning.hyperparameters import Evidence
from onebend.learning.linear import (
    FitProblem,
    Hyperparameters,
    RecordingNoise,
    data_information,
    log_k_map,
    unweighted_rows,
)
from onebend.learning.normal import JUMP, RHO, SPREAD, TAU, Draws, stiffness_mixture
from onebend.learning.parameters import Layout, Spline, make_layout
from onebend.learning.prediction import predict
from onebend.records import Array, ForceNoise, Observations
from tests.lab.from_truth import observe_from_truth

COLOURED, MEMORY, WALK, WHITE = 0.02, 0.3, 0.004, 0.004  # parts of the largest force; s
CLOCK = 0.01  # s
LEVEL, LEVEL_SD, SLOPE_SD = float(np.log(0.02)), 0.3, 0.5  # of log k
THIRDS = 3
# Those that need no camera's place. Of the mass in motion the basis is the tags' own accelerations, noise and all.
ALLOWED: frozenset[str] = EVERY_ALLOWANCE - {"inertia", "camera", "rolling shutter"}
LARGEST_SIZE = 3.0  # drawn; their prior, a half-Cauchy, goes on for ever
SETTLE = 3  # times that the course of the push is taken from where the tags then are


@dataclass(frozen=True)
class Drawn:
    """A draw of everything, and the observations that it leads to."""

    observations: Observations
    stiffness: LogSpline
    problem: FitProblem
    x: Array  # (P,) true parameters
    own: Array  # (F, 2) N, the force less the logged one without its slow error


def draw(seed: int, *, functions: int = 16, fixed: bool = False, allowances: frozenset[str] = frozenset()) -> Drawn:
    """One draw; with `fixed`, k(s) and the push are those of seed 0 and all else is drawn."""
    rng, own = np.random.default_rng([seed, 11]), np.random.default_rng([0 if fixed else seed, 12])
    spline = Spline(functions)
    k = spline.parts @ draw_parts(spline, own)
    stiffness = LogSpline(tuple(spline.knots.tolist()), tuple(k.tolist()))
    beam = Beam(0.15, stiffness)
    direction = own.uniform(1.4, 2.1)
    peak = force_that_bends(beam, own.uniform(0.7, 1.3), direction)
    push = PushProfile(peak, direction=direction, turn=own.uniform(0.2, 0.8))
    exact = virtual_recording(VirtualBench(beam, push, sensor=ForceSensor()), seed=seed)
    template = observe_from_truth(exact, clock_sd=CLOCK)
    assert template.source.clean_force is not None
    noise = ForceNoise(white=0.0, coloured=COLOURED * peak, tau=MEMORY, walk=WALK * peak)
    clean = replace(template.source.clean_force, noise=noise)
    template = replace(
        template, force_sd=np.full(2, COLOURED * peak), source=replace(template.source, clean_force=clean)
    )
    problem = prepared(template, spline, allowances)
    (data,), layout = problem.recordings, problem.layout
    sizes = {one.name: draw_size(rng) for one in data.allowances if one.sized}
    x = np.zeros(layout.size)
    for block in layout.blocks:
        if block.start >= 0 and block.name not in ("stiffness", "force"):
            sd = block.prior_sd * sizes.get(block.name, 1.0)
            x[block.where] = sd * rng.standard_normal(len(sd))
    x[: spline.count] = k
    root = data.error.root(1.0, 1.0, 1.0, 1.0)
    errors = root @ rng.standard_normal((len(root), 2))
    x[layout.index["force", 0].where] = errors.ravel()
    log_error = spline_at(data, clean.time) @ errors
    rest_noise = problem.recordings[0].error.rest_sd * rng.standard_normal(clean.force.shape)
    logged = replace(clean, force=clean.force + log_error + rest_noise)
    force = template.force.copy()
    force[data.frames] += data.error.weights @ errors
    template = replace(template, force=force, source=replace(template.source, clean_force=logged))
    problem = prepared(template, spline, allowances)
    (data,) = problem.recordings
    for _ in range(SETTLE if allowances else 0):
        template = with_poses(template, data, predict(data, layout, x, None).pose)
        problem = prepared(template, spline, allowances)
        (data,) = problem.recordings
    poses = noisy_poses(data, layout, x, rng)
    quick = WHITE * peak * rng.standard_normal((int(data.frames.sum()), 2))
    force[data.frames] += quick  # the log is off, not the force
    template = replace(template, force=force)
    beside = np.vstack([-quick, np.zeros((len(poses) - len(quick), 2))])
    expected = replace(problem.expected, noise=(RecordingNoise(1.0, WHITE * peak),), sizes=sizes)
    observations = with_poses(template, data, poses)
    problem = replace(prepared(observations, spline, allowances), expected=expected)
    return Drawn(observations, with_patches(problem, x), problem, x, beside)


def draw_size(rng: np.random.Generator) -> float:
    """The size of an allowance from the prior that the fit has of it, but for its tail."""
    while True:
        size = abs(float(rng.standard_cauchy()))
        if size < LARGEST_SIZE:
            return size


def with_patches(problem: FitProblem, x: Array) -> LogSpline:
    """k(s) with what stiffens the beam under its tags."""
    index, onto = log_k_map(problem)
    return LogSpline(tuple(problem.layout.spline.finer.knots.tolist()), tuple((onto @ x[index]).tolist()))


def draw_parts(spline: Spline, rng: np.random.Generator) -> Array:
    """(n,) parts of log k from their prior, that of its sizes included; level and slope drawn narrower."""
    while True:
        tau, rho = np.array([TAU, RHO]) * np.exp(SPREAD * rng.standard_normal(2))
        local = rho * spline.share * rng.standard_cauchy(len(spline.share))
        if rng.random() < np.exp(-0.5 * np.sum((local / JUMP) ** 2)):
            break
    line = [LEVEL + LEVEL_SD * rng.standard_normal(), SLOPE_SD * rng.standard_normal()]
    return np.concatenate([line, tau * rng.standard_normal(spline.count - 2), local])


def prepared(o: Observations, spline: Spline, allowances: frozenset[str]) -> FitProblem:
    """As the fit prepares them: every loaded frame."""
    data = fit_data(o, 0, o.loaded, spline, allowances)
    layout = make_layout(spline, [o], [len(data.error.knots)], [data.allowances])
    noise = (RecordingNoise(1.0, 1.0),)
    return FitProblem((data,), layout, LEVEL, Hyperparameters(spline.variances(TAU, RHO), 1.0, 1.0, 1.0, 1.0, noise))


def spline_at(data: FitData, time: Array) -> Array:
    """(N, K) weights of the force error's knots at `time`, constant beyond them."""
    knots = data.error.knots
    held = np.clip(time, knots[1], knots[-2])
    u = np.abs(held[:, None] - knots) / (knots[1] - knots[0])
    near, far = 2.0 / 3.0 - u**2 + 0.5 * u**3, (2.0 - np.minimum(u, 2.0)) ** 3 / 6.0
    return np.asarray(np.where(u < 1.0, near, far))


def noisy_poses(data: FitData, layout: Layout, x: Array, rng: np.random.Generator) -> Array:
    """(F, m, 3) tags where x puts them, with the noise that their covariances state."""
    pose = predict(data, layout, x, None).pose
    roots = np.linalg.inv(data.whiten)
    return np.asarray(pose + np.einsum("fmab,fmb->fma", roots, rng.standard_normal(pose.shape)))


def with_poses(o: Observations, data: FitData, poses: Array) -> Observations:
    """The observations with these tags in the frames of the film, the last of which is the rest."""
    xy, angle = o.xy.copy(), o.angle.copy()
    xy[data.frames], angle[data.frames] = poses[:-1, :, :2], poses[:-1, :, 2]
    return replace(o, xy=xy, angle=angle, rest_xy=poses[-1, :, :2], rest_angle=poses[-1, :, 2])


def thirds(spline: Spline) -> Array:
    """(3, p): means of log k over the thirds of the beam, of the spline's coefficients."""
    s = (np.arange(300) + 0.5) / 300
    return np.asarray(spline.basis(s).reshape(THIRDS, 100, spline.count).mean(axis=1))


def least_variance(drawn: Drawn, *, prior_of_k: bool) -> Array:
    """(3,) of the means of log k over thirds: what is possible at the truth, hyperparameters known but for log k's.

    The model linearised at the truth, with the data as drawn and the priors of what is random. With the prior of k too
    it is the variance of the exact posterior, sizes of log k averaged over: no estimator's mean squared error over
    draws is less than its mean. Without it, the Cramer-Rao bound on any unbiased estimator for this k, the rest being
    random and integrated out.
    """
    problem, spline = drawn.problem, drawn.problem.layout.spline
    now = predict(problem.recordings[0], problem.layout, drawn.x, None, drawn.own)
    data = data_information(problem, [unweighted_rows(now)], drawn.x, problem.expected)
    evidence = Evidence(problem, data)
    form = evidence.stiffness_form(evidence.posterior(problem.expected))
    covariance = np.linalg.pinv(form.matrix, hermitian=True)
    if prior_of_k:
        covariance = stiffness_mixture(spline, [form], LEVEL, Draws(30, 50, 150)).covariance
    g = thirds(spline)
    return np.asarray(np.einsum("gi,ij,gj->g", g, covariance, g))
