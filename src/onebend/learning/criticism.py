"""Does the fit's own model hold? Score tests against alternatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.special import chdtrc, fdtrc

from onebend.beam.grid import apply
from onebend.beam.sensitivity import Perturbation, of_clamp_angle, of_rest_curvature, of_stiffness
from onebend.beam.statics import Equilibrium
from onebend.beam.stiffness import UncertainStiffness
from onebend.learning import fit_data, linear, normal, optimizer, parameters, prediction
from onebend.learning.frames import unwhitened, whitened
from onebend.progress import each
from onebend.recording.signals import correlation_time
from onebend.records import Array, IntArray, left_of, unit

# Alternatives to the fit's model: a few numbers b that the model takes to be zero. They move the tags by `D b`, with D
# from the derivatives of the equilibrium at the optimum.

Kind = Literal["prior", "mechanics", "change", "trend"]

UNITS = {  # of what the beam and the push may do otherwise
    "stretch": "1/N",
    "shear": "1/N",
    "length": "1",
    "push place": "1",
    "push beside": "m",
    "force direction": "rad",
    "axis scale": "1",
    "force curve": "1",
    "weight": "N",
    "viscous": "N m s",
    "clamp gives": "rad/(N m)",
    "rest shape": "rad",
    "stiffness along": "1",
}
_ALLOWED = {  # what the fit may allow for, and what need not be tested then
    "section": ("stretch", "shear"),
    "length": ("length",),
    "relaxation": ("viscous",),
    "clamp gives": ("clamp gives",),
}
AXES = ("x", "y", "angle")


@dataclass(frozen=True)
class Suspect:
    """What may be otherwise than the model takes it to be."""

    kind: Kind
    name: str
    tag: int = -1  # its id; -1: no tag's own
    recording: str = ""  # empty: of the beam, alike in all recordings


@dataclass(frozen=True)
class Alternative:
    """n numbers that the model takes to be zero, and what they do to one film's tags."""

    suspect: Suspect
    pattern: Array  # (F, m, 3, n) m, m, rad per unit
    log_k: Array | None = None  # (p, n) what they are of log k's coefficients; None: nothing


@dataclass(frozen=True)
class Course:
    """How a film runs, F frames each; the frame at rest comes last where there is one."""

    bend: Array  # (F,) 0 to 1, share of the largest bending
    after: Array  # (F,) 1 after the largest bending
    past: Array  # (F,) 0 to 1, share of the bending so far, summed over time
    resting: Array  # (F,) 1 for the frame at rest


def course(data: fit_data.FitData, now: prediction.Prediction) -> Course:
    """From the fitted shapes and the frames' times."""
    time = data.observations.time[data.frames]
    frames, count = len(time), len(now.pose)
    q = now.solved.q - now.solved.problem.q0
    bend = np.sqrt(np.mean(q**2, axis=1))
    bend = bend / max(float(np.max(bend)), 1e-300)
    step = np.gradient(time) if frames > 1 else np.ones(frames)
    past, after, resting = np.zeros(count), np.zeros(count), np.zeros(count)
    total = np.cumsum(bend[:frames] * step)
    past[:frames] = total / max(float(total[-1]), 1e-300)
    after[:frames] = np.arange(frames) > int(np.argmax(bend[:frames]))
    resting[frames:] = 1.0
    return Course(bend, after, past, resting)


def alternatives(data: fit_data.FitData, layout: parameters.Layout, now: prediction.Prediction) -> list[Alternative]:
    """All that are tested on one film."""
    run, patterns = course(data, now), mechanics(now)
    pliant = patterns["clamp"] * _clamp_moment(now.solved)[:, None, None, None]
    wanted = {name: patterns[name] for name in UNITS if name in patterns} | {"clamp gives": pliant}
    if layout.index["curvature", -1].start >= 0 or layout.index["rest change", data.number].start >= 0:
        del wanted["rest shape"]
    along, stated = Suspect("mechanics", "stiffness along"), []
    otherwise = wanted.pop(along.name)
    if layout.known is not None:
        stated.append(Alternative(along, otherwise, layout.spline.nearest(_along)))
    for allowed, names in _ALLOWED.items():
        if any(a.name == allowed for a in data.allowances):
            for name in names:
                wanted.pop(name, None)
    if data.observations.static:  # poses have no order in time
        wanted.pop("viscous", None)
        return [*stated, *(Alternative(Suspect("mechanics", name), pattern) for name, pattern in wanted.items())]
    stiff = [Alternative(Suspect("mechanics", name), pattern) for name, pattern in wanted.items()]
    return [*stated, *stiff, *_changes(data, run, patterns), *_trends(data, run)]


def mechanics(now: prediction.Prediction) -> dict[str, Array]:
    """(F, m, 3, n) per unit of what `UNITS` names, and of the clamp's angle ("clamp")."""
    carried, ride = _carried(now), now.riding
    patterns = {}
    columns = prediction.response_columns(_entering(now.data, now))
    for name, part in prediction.place_responses(now.solved, columns, now.s).items():
        if name in carried:
            part[:, :, :2] += carried[name][..., None]
        patterns[name] = ride.carry(part)
    return patterns


def _entering(data: fit_data.FitData, now: prediction.Prediction) -> dict[str, Perturbation]:
    """Perturbations of the balance of moments. With N = (N_u, N_n) along and across, `M' = -L N_n`. A stretch e = N_u /
    (E A) makes it -L (1 + e) N_n, a shear g = N_n / (G A) adds L g N_u (Reissner's beam)."""
    solved, problem = now.solved, now.solved.problem
    u, n = _tangents(solved)
    force = problem.dead_force
    product = (np.sum(force * u, axis=-1) * np.sum(force * n, axis=-1))[..., None] * n
    pushed = data.beyond[..., None] * now.force[:, None, :]
    along, across = prediction.along_and_across(now.force, solved.angle(data.push_s[:, None])[:, 0])
    loaded = (np.arange(len(force)) < int(np.sum(data.frames))).astype(float)
    share = np.linalg.norm(now.force, axis=1) / max(float(np.max(np.linalg.norm(now.force, axis=1))), 1e-300)
    curve = now.force[..., None] * np.stack([share, share**2], axis=1)[:, None]
    sag = (loaded[:, None] * (1.0 - problem.grid.nodes))[..., None, None] * np.eye(2)
    return {
        "stretch": _force(product),
        "shear": _force(-product),
        "length": _force(force),
        "push place": prediction.push_moment(problem, data.push_s, float(problem.length) * across),
        "push beside": prediction.push_moment(problem, data.push_s, -along),
        "force direction": _force(left_of(pushed)),
        "axis scale": _force(pushed * np.array([1.0, -1.0])),
        "force curve": prediction.pushed_by(data.beyond, curve),
        "weight": Perturbation(sag, None, None, np.zeros(2)),
        "viscous": Perturbation(None, None, (_rate(data, solved), np.ones((force.shape[1], 1))), np.zeros(1)),
        "clamp": of_clamp_angle(problem),
        "clock": prediction.pushed_by(data.beyond, prediction.push_forces(now.force, now.log_axes, data.rate)["clock"]),
        "rest shape": of_rest_curvature(problem, fit_data.REST_MODES.curvature(problem.grid.nodes)),
        "stiffness along": of_stiffness(solved, problem.k[..., None] * _along(problem.grid.nodes)),
    }


def _along(s: Array) -> Array:
    """(..., n) Legendre polynomials of s, the constant left out."""
    return np.asarray(np.polynomial.legendre.legvander(2.0 * s - 1.0, 3)[..., 1:])


def _carried(now: prediction.Prediction) -> dict[str, Array]:
    """(F, m, 2) m per unit that the tags move by without a turn of the beam: `r' = L (1 + e) u + L g n`."""
    solved, s = now.solved, now.s
    u, n = _tangents(solved)
    force, rows = solved.problem.dead_force, solved.problem.grid.integral_to(s)
    length = float(solved.problem.length)

    def path(slope: Array) -> Array:
        return np.stack([apply(rows, slope[..., c]) for c in range(2)], axis=-1)

    return {
        "stretch": length * path(np.sum(force * u, axis=-1)[..., None] * u),
        "shear": length * path(np.sum(force * n, axis=-1)[..., None] * n),
        "length": solved.xy(s),
    }


def _clamp_moment(solved: Equilibrium) -> Array:
    """(F,) N m that the loads bend the clamp with."""
    problem, (_, n) = solved.problem, _tangents(solved)
    return np.asarray(np.sum(problem.length * problem.weights * np.sum(problem.dead_force * n, axis=-1), axis=-1))


def _changes(data: fit_data.FitData, run: Course, patterns: dict[str, Array]) -> list[Alternative]:
    name = data.observations.source.name
    frames, tags = patterns["clamp"].shape[:2]
    place = np.zeros((frames, tags, 3, 2))
    place[:, :, 0, 0] = place[:, :, 1, 1] = 1.0
    slip = np.concatenate([patterns["clamp"], place], axis=-1)
    out = [
        Alternative(Suspect("change", "creep", recording=name), _in_time(patterns["rest shape"], run)),
        Alternative(Suspect("change", "slip", recording=name), _in_time(slip, run)),
        Alternative(Suspect("change", "clock runs", recording=name), _in_time(patterns["clock"], run)),
    ]
    for i in data.tags.tolist():
        tag = int(data.observations.tag_id[i])
        own = np.zeros((frames, tags, 3, 3))
        own[:, i] = np.eye(3)
        out.append(Alternative(Suspect("change", "loose", tag, name), _in_time(own, run)))
    return out


def _trends(data: fit_data.FitData, run: Course) -> list[Alternative]:
    side, ids = run.after - 0.5, data.observations.tag_id
    smooth = [run.bend, run.bend**2, run.bend * side, run.bend**2 * side, run.past]
    functions = np.stack(smooth, axis=1) * (1.0 - run.resting[:, None])
    out = []
    for i in data.tags.tolist():
        for c, axis in enumerate(AXES):
            pattern = np.zeros((len(run.bend), len(ids), 3, len(smooth)))
            pattern[:, i, c] = functions
            out.append(Alternative(Suspect("trend", axis, int(ids[i]), data.observations.source.name), pattern))
    return out


def _in_time(pattern: Array, run: Course) -> Array:
    return np.concatenate([f[:, None, None, None] * pattern for f in (run.past, run.after)], axis=-1)


def _tangents(solved: Equilibrium) -> tuple[Array, Array]:
    """(F, Q, 2) along and across the beam at the nodes."""
    along = unit(solved.alpha)
    return along, left_of(along)


def _force(force: Array) -> Perturbation:
    """One parameter that adds the internal force (F, Q, 2)."""
    return Perturbation(force[..., None], None, None, np.zeros(1))


def _rate(data: fit_data.FitData, solved: Equilibrium) -> Array:
    """(F, Q) rad/s of the curvature; zero at rest."""
    time = data.observations.time[data.frames]
    out = np.zeros_like(solved.q)
    if len(time) > 1:
        out[: len(time)] = np.gradient(solved.q[: len(time)], time, axis=0)
    return out


# Score tests (Rao 1948). With `r = J x + D b + noise` and x integrated out, b has the information
# `C^-1 = H_bb - H_bx (H_xx + P)^-1 H_xb`, and `g' C g` of its score g is chi-squared. If b stands out, the noise is
# estimated again with b free, and the F distribution is used. Of a parameter with a prior,
# `x' (prior - posterior covariance)^-1 x` is chi-squared.

_BLIND = 1e-8  # share of the information on b: less remains only where the model's own parameters do the same
_LEAST_REMOVED = 0.05  # share of the prior variance: a pull is judged where the data have removed more than this
_NEW_NOISE = -2.0  # log10 of chi-squared's p: the noise is estimated anew below it


@dataclass(frozen=True)
class Score:
    """One test."""

    suspect: Suspect
    value: Array  # (n,) the numbers, freed; NaN where the model's own parameters can do the same
    sd: Array  # (n,) of it; before the data where the model has it under a prior
    gain: float  # decrease of -2 log p when it is freed, under the noise that is then left
    log10_p: float  # log10 of the probability of as large a gain, the model being right
    size: float  # m, RMS over the frames of what the tag that it moves most moves by, all else refitted
    shift: Array  # (p,) by which the coefficients of log k change
    noise: float = 1.0  # variance that the fit took for noise over what is left of it, not below 1

    @property
    def able(self) -> bool:
        """Whether the data tell anything of it, beside the model's own parameters."""
        return bool(np.all(np.isfinite(self.value)))


@dataclass(frozen=True)
class LinearisedFit:
    """The linearised model at the optimum."""

    problem: linear.FitProblem
    optimum: optimizer.Optimum
    rows: tuple[linear.ResidualRows, ...]  # of each recording
    known: tuple[IntArray, ...]  # indices of the parameters that each recording depends on
    solved: linear.Solved  # the posterior at the optimum's hyperparameters
    covariance: normal.JointCovariance  # the same
    step: Array  # (P,) to where the slope is zero


def linearised(problem: linear.FitProblem, optimum: optimizer.Optimum) -> LinearisedFit:
    """The linearised model at an optimum."""
    layout, x, noise = problem.layout, optimum.x, optimum.hyperparameters.noise
    rows = each(linear.residual_rows, optimum.predictions, noise)
    before = linear.prior(problem, optimum.hyperparameters)
    posterior = linear.solved(linear.data_information(problem, rows, x, optimum.hyperparameters), before)
    known = tuple(layout.known_to(recording.number) for recording in problem.recordings)
    return LinearisedFit(problem, optimum, rows, known, posterior, posterior.covariance, posterior.mean - x)


def pulls(fit: LinearisedFit) -> list[Score]:
    """Tests of the priors: of each tag by itself, of the parts of other blocks together. Directions without information
    are left out. Place and direction of the push are among the alternatives."""
    untested = {"stiffness", "force", "place", "direction", "end", "end turn", "zero"}
    untested |= {a.name for recording in fit.problem.recordings for a in recording.allowances}
    out = []
    for block in fit.problem.layout.blocks:
        if block.start < 0 or block.name in untested:
            continue
        whose = "" if block.recording < 0 else fit.problem.recordings[block.recording].observations.source.name
        tags = (
            fit.problem.recordings[0].observations.tag_id[fit.problem.recordings[0].tags].tolist()
            if block.name in ("along", "across", "turn")
            else [-1]
        )
        usual = np.zeros(len(block.labels)), block.prior_sd
        mean, sd = fit.optimum.hyperparameters.sites.get((block.name, block.recording), usual)
        for i, tag in enumerate(tags):
            own = np.array([i]) if tag >= 0 else np.arange(len(block.labels))
            suspect = Suspect("prior", block.name, tag, whose)
            out.append(_pull(fit, suspect, block.start + own, block.prior_sd[own], (mean[own], sd[own]), block.unit))
    return out


def _pull(
    fit: LinearisedFit, suspect: Suspect, index: IntArray, before: Array, site: tuple[Array, Array], unit: str
) -> Score:
    """Against the stated tolerance `before` (n,), where the fit has normal priors of the means and sds `site`."""
    where, (middle, sd) = slice(int(index[0]), int(index[-1]) + 1), site
    information = np.linalg.inv(fit.covariance.among(where))
    after = np.linalg.inv(information + np.diag(before**-2.0 - sd**-2.0))
    x = after @ (information @ fit.optimum.x[index] - middle / sd**2)
    removed = np.eye(len(index)) - after / np.outer(before, before)
    values, vectors = np.linalg.eigh(0.5 * (removed + removed.T))
    judged = values > _LEAST_REMOVED
    freed = vectors[:, judged] @ ((vectors[:, judged].T @ (x / before)) / values[judged])  # in prior sds
    gain, count = float(freed @ (x / before)), int(np.sum(judged))
    log10_p = _log10(chdtrc(count, gain)) if count else 0.0
    shift = fit.covariance.shared_with(where)[: fit.problem.layout.spline.count] @ ((before * freed - middle) / sd**2)
    size = float(np.linalg.norm(x)) if unit == "m" else 0.0
    return Score(suspect, before * freed if count else np.full(len(x), np.nan), before, gain, log10_p, size, shift)


def scores(fit: LinearisedFit, patterns: Sequence[Sequence[Alternative]]) -> list[Score]:
    """The tests of the alternatives of each recording. Those of one suspect are tested together."""
    places: dict[Suspect, list[tuple[int, Alternative]]] = {}
    for number, alternatives in enumerate(patterns):
        for one in alternatives:
            places.setdefault(one.suspect, []).append((number, one))
    return list(each(lambda suspect, shown: _score(fit, suspect, shown), places, places.values()))


def _marginal(fit: LinearisedFit, numbers: Sequence[int], mixed: Sequence[Array]) -> tuple[Array, list[Array]]:
    """(n, n) information that the parameters take from n freed numbers, and their response (C, n) in each recording.

    `mixed`: (n, C) of each recording, the information on the numbers together with its parameters.
    """
    if len(numbers) == 1:
        response = fit.covariance.pairs[numbers[0]] @ mixed[0].T
        return mixed[0] @ response, [response]
    wide = np.zeros((fit.problem.layout.size, len(mixed[0])))
    for number, one in zip(numbers, mixed, strict=True):
        wide[fit.known[number]] += one.T
    whole = fit.solved.times_covariance(wide)
    return wide.T @ whole, [whole[fit.known[number]] for number in numbers]


def _mixed(fit: LinearisedFit, number: int, pattern: Array) -> tuple[Array, Array, Array, Array]:
    """A pattern (F, m, 3, n) in one recording: whitened (F, R, n), its information (n, n) and that with the parameters
    (n, C), and the score (n,)."""
    recording, rows, noise = fit.problem.recordings[number], fit.rows[number], fit.optimum.hyperparameters.noise[number]
    d = rows.root_weight[..., None] * whitened(recording.whiten, pattern)
    unexplained = d - rows.a @ (linear.force_shrinkage(rows, noise) @ (np.swapaxes(rows.a, 1, 2) @ d))
    weighted = unexplained.reshape(-1, d.shape[-1]) / noise.marker**2
    bb = weighted.T @ d.reshape(-1, d.shape[-1])
    return d, bb, rows.onto_parameters(weighted.reshape(d.shape)), weighted.T @ rows.r.ravel()


def _score(fit: LinearisedFit, suspect: Suspect, shown: Sequence[tuple[int, Alternative]]) -> Score:
    p, log_k = fit.problem.layout.spline.count, shown[0][1].log_k
    numbers = [number for number, _ in shown]
    patterns, own, mixed, slopes = zip(*(_mixed(fit, number, one.pattern) for number, one in shown), strict=True)
    bb, (taken, responses) = np.sum(own, axis=0), _marginal(fit, numbers, mixed)
    parts = zip(numbers, mixed, slopes, strict=True)
    score = np.sum([slope - bx @ fit.step[fit.known[number]] for number, bx, slope in parts], axis=0)
    size = np.sqrt(np.maximum(np.diag(bb), 1e-300))
    scaled = (bb - taken) / np.outer(size, size)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    visible = values > _BLIND
    count = int(np.sum(visible))
    if count == 0:
        unknown = np.full(len(size), np.nan)
        return Score(suspect, unknown, unknown, 0.0, 0.0, 0.0, np.zeros(p))
    inverse = (vectors[:, visible] / values[visible]) @ vectors[:, visible].T / np.outer(size, size)
    b = inverse @ score
    chi2 = float(score @ b)
    log10_p, ratio = _log10(chdtrc(count, chi2)), 1.0
    steps = [-response @ b for response in responses]
    every = zip(numbers, patterns, steps, strict=True)
    changes = {number: d @ b + fit.rows[number].moved_by(step) for number, d, step in every}
    if log10_p < _NEW_NOISE:
        ratio, independent = _noise_left(fit, changes)
        chi2 *= ratio
        log10_p = _log10(fdtrc(count, max(independent - len(b), 5.0), chi2 / count))
    moved = max(_moved(fit.problem.recordings[number], fit.rows[number], c) for number, c in changes.items())
    sd = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    shift = steps[0][:p] if log_k is None else steps[0][:p] + log_k @ b
    return Score(suspect, b, sd, chi2, log10_p, moved, shift, max(ratio, 1.0))


def _noise_left(fit: LinearisedFit, changes: Mapping[int, Array]) -> tuple[float, float]:
    """Ratio of the fit's noise variance to that left after the changes (F, R) of the residuals, with correlation in
    time, and the number of independent values left. The coordinate with the longest correlation counts: a smooth
    alternative must not pass for signal where one tag's noise is slow."""
    before, after, numbers = 0.0, 0.0, 0.0
    for number, change in changes.items():
        rows, noise = fit.rows[number], fit.optimum.hyperparameters.noise[number]
        plain = rows.r - rows.moved_by(fit.step[fit.known[number]])
        old, new = (linear.split_off_force(rows, r, noise)[0] for r in (plain, plain - change))
        time = max(correlation_time(column[:, None]) for column in new.T)
        before += float(np.sum(old**2)) * correlation_time(old)
        after += float(np.sum(new**2)) * time
        numbers += float(np.sum(rows.known)) / time
    return before / max(after, 1e-300), numbers


def _moved(data: fit_data.FitData, rows: linear.ResidualRows, change: Array) -> float:
    """m: RMS over the frames of the tag that a change (F, R) of the whitened poses moves most."""
    weight = np.where(rows.root_weight > 0.0, rows.root_weight, 1.0)
    away = unwhitened(data.whiten, change / weight)[..., :2]
    known = np.any(rows.known.reshape(len(away), -1, 3), axis=-1)  # a pose may lack its angle, or a coordinate
    squares = np.sum(away**2, axis=-1)
    return float(np.sqrt(np.max(np.sum(squares, axis=0) / np.maximum(np.sum(known, axis=0), 1))))


def _log10(chance: float) -> float:
    return float(np.log10(chance)) if chance > 0.0 else -np.inf


# The tests together. If one stands out as none does in clean recordings, the band is not to be trusted. It is not
# widened: a wrong model moves k(s) by an unknown amount.

# log10 p of one test of about 45: under one false alarm in 2,000 recordings.
ALARM = -5.0
# The same for values that a person writes down, and for sensors: they are wrong more often, and hardly show.
ALARM_WRITTEN = -2.5
WRITTEN = ("push place", "force direction", "axis scale", "force curve", "stiffness along")
_AS_LIKELY = 10.0  # of -2 log p: a cause that explains less than the best by no more is named beside it
_SHARE = 0.8  # of the best cause's gain: the same, where the misfit is large
_MOST_NAMED = 3  # causes and symptoms that are named
_MATTERS = 0.5  # sd of log k: a smaller shift lowers the coverage of a 95 % band to 92 % at most, and gets a note only


@dataclass(frozen=True)
class Finding:
    """One test, with what it means for k(s)."""

    score: Score
    shift: float  # largest change of log k over the identified places if it is freed
    sds: float  # the same in sds of log k

    @property
    def matters(self) -> bool:
        """Whether the change is no small part of the band, as that would be without the misfit's share of its noise."""
        return bool(self.sds * np.sqrt(self.score.noise) > _MATTERS)


@dataclass(frozen=True)
class Criticism:
    """All tests, the most striking first."""

    findings: tuple[Finding, ...]
    alarm: float = ALARM  # log10 p beyond which a test counts

    @property
    def able(self) -> tuple[Finding, ...]:
        """Those of which the data tell anything."""
        return tuple(f for f in self.findings if f.score.able)

    @property
    def striking(self) -> tuple[Finding, ...]:
        """Those that clean recordings do not show."""
        return tuple(f for f in self.findings if f.score.log10_p < self.level(f))

    def level(self, finding: Finding) -> float:
        """log10 p beyond which one test counts."""
        return max(self.alarm, ALARM_WRITTEN) if finding.score.suspect.name in WRITTEN else self.alarm

    @property
    def alarms(self) -> tuple[Finding, ...]:
        """Those of them that put k(s) in doubt."""
        return tuple(f for f in self.striking if f.matters)

    @property
    def trusted(self) -> bool:
        """Whether the band may be relied on, as far as the recording itself can tell."""
        return not self.alarms

    @property
    def causes(self) -> tuple[Finding, ...]:
        """What would explain the misfit, freed by itself: the best first, and those that are about as good."""
        able = sorted((f for f in self.alarms if f.score.suspect.kind != "trend"), key=lambda f: -f.score.gain)
        if not able:
            return ()
        most = able[0].score.gain
        least = min(most - _AS_LIKELY, _SHARE * most)
        return tuple(f for f in able if f.score.gain >= least)[:_MOST_NAMED]

    @property
    def symptoms(self) -> tuple[Finding, ...]:
        """Tags and coordinates whose residuals are no noise, the largest first."""
        trends = [f for f in self.alarms if f.score.suspect.kind == "trend"]
        return tuple(sorted(trends, key=lambda f: -f.score.size))[:_MOST_NAMED]

    @property
    def widening(self) -> float:
        """Factor on the band to contain k(s) with the best cause freed; 1 if trusted, NaN if no cause is known."""
        if self.trusted:
            return 1.0
        return float(np.hypot(1.0, self.causes[0].sds)) if self.causes else np.nan

    def as_dict(self) -> dict[str, Any]:
        """For JSON: the verdict, and every test."""
        return {
            "trusted": self.trusted,
            "alarm_log10_p": self.alarm,
            "widening": self.widening,
            "causes": [_as_dict(f) for f in self.causes],
            "symptoms": [_as_dict(f) for f in self.symptoms],
            "tests": [_as_dict(f) for f in self.findings],
        }


def criticise(problem: linear.FitProblem, optimum: optimizer.Optimum, stiffness: UncertainStiffness) -> Criticism:
    """Test the model of a fit that has ended."""
    fit, layout = linearised(problem, optimum), problem.layout
    patterns = each(lambda now: alternatives(now.data, layout, now), optimum.predictions)
    tests = [*scores(fit, patterns), *pulls(fit)]
    s = np.linspace(0.0, 1.0, 101)
    identified = stiffness.band(s).identified
    s = s[identified] if np.any(identified) else s
    sd, basis = stiffness.log_at(s)[1], layout.spline.basis(s)
    findings = [_finding(score, basis @ score.shift, sd) for score in tests]
    return Criticism(tuple(sorted(findings, key=lambda f: f.score.log10_p)))


def _finding(score: Score, shift: Array, sd: Array) -> Finding:
    return Finding(score, float(np.max(np.abs(shift))), float(np.max(np.abs(shift) / sd)))


def _as_dict(finding: Finding) -> dict[str, Any]:
    score, suspect = finding.score, finding.score.suspect
    return {
        "kind": suspect.kind,
        "name": suspect.name,
        "tag": suspect.tag if suspect.tag >= 0 else None,
        "recording": suspect.recording or None,
        "value": score.value,
        "sd": score.sd,
        "gain": score.gain,
        "log10_p": score.log10_p,
        "size_m": score.size,
        "shift_log_k": finding.shift,
        "shift_sds": finding.sds,
        "matters": finding.matters,
    }
