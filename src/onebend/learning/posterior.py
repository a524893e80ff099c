"""k(s) with a band: maximum a posteriori in marker space, through the exact equilibrium. Parameters are log k(s), rest
shape, tags, clamp, clock offset and slow force error. Data are the tags of loaded frames and at rest, and the force log
without a push. Hyperparameters are chosen by evidence; the band is Laplace's approximation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from onebend.beam.grid import Modes
from onebend.beam.model import Beam
from onebend.beam.stiffness import SHAPE_PLACES, Band, Profile, Scaled, Table, UncertainStiffness, Uniform, by_legendre
from onebend.errors import LearningError
from onebend.learning import attribution, frames, hyperparameters, linear, normal, optimizer, prediction
from onebend.learning.allowances import BETWEEN, BETWEEN_SD, SHARES
from onebend.learning.condensed import condensed
from onebend.learning.criticism import Criticism, criticise
from onebend.learning.fit_data import FitData, following
from onebend.learning.frequencies import GROSS, PredictedFrequencies, worst_off
from onebend.learning.parameters import KNOWN, LEARNED, POWER, Block, Layout, LearnedMass, with_shared_shape
from onebend.learning.push_place import FAR, PlaceSearch, doubtful, moved_off, search_place, with_places
from onebend.learning.start import start_of
from onebend.progress import Progress, Silent, one_blas_thread
from onebend.records import Array, BoolArray, Observations, PointMass, tags_among


def stiffness_of(problem: linear.FitProblem, optimum: optimizer.Optimum, gain_sd: float) -> UncertainStiffness:
    """k(s) and its band at an optimum, with the stiffening by tags and the unknown places of steps between knots."""
    layout = problem.layout
    fine, (index, onto) = layout.spline.finer, linear.log_k_map(problem)
    covariance = optimum.covariance.of_shared[np.ix_(index, index)]
    patches = slice(layout.spline.count, None)
    covariance[patches, patches] += unknown_width(optimum.x[index[patches]], covariance[patches, patches])
    covariance = onto @ covariance @ onto.T
    covariance += np.tensordot(optimum.jumps**2, layout.spline.unseen, 1)
    known = layout.known
    offset = None if known is None else known.offset
    nominal = None
    if offset is not None:
        p, on_finer, variances = layout.spline.count, layout.spline.on_finer, optimum.hyperparameters.part_variances
        found = optimum.x[:p] - problem.level, optimum.covariance.of_shared[:p, :p]
        log_k, spread = without_section_errors(layout, variances, *found)
        of_modulus = _symmetric(on_finer @ spread @ on_finer.T)
        nominal = UncertainStiffness(fine.knots, on_finer @ (problem.level + log_k), of_modulus, gain_sd, offset=offset)
    return UncertainStiffness(
        fine.knots,
        onto @ optimum.x[index],
        _symmetric(covariance),
        gain_sd,
        shape=optimum.shape,
        offset=offset,
        nominal=nominal,
    )


def unknown_width(patches: Array, covariance: Array) -> Array:
    """(n, n) covariance to be added to that of the patches under tags, their means being `patches` (n,): a patch has
    one of the widths, and where a positive parameter stands for each, their normal density leaves too little open of
    how the whole effect a is shared. With shares q of the widths its covariance is `a^2 (diag q - q q')`."""
    if not len(patches):
        return covariance
    shared = np.eye(len(SHARES)) - SHARES[:, None]  # less the whole effect
    left = np.sum(patches) ** 2 * (np.diag(SHARES) - np.outer(SHARES, SHARES)) - shared @ covariance @ shared.T
    values, vectors = np.linalg.eigh(left)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def prior_part(problem: linear.FitProblem, optimum: optimizer.Optimum, s: Array) -> Array:
    """(S, S) the part of log k's covariance at `s` that comes from the prior. The fit's log k is off by `C P^-1 (m -
    k)`, plus the effect of errors of the data; C is the covariance, P and m the prior's. Over the prior's beams the
    first has covariance `C P^-1 C`. A second recording of a like beam shares it. P has the mean sizes of the prior's
    parts."""
    layout = problem.layout
    p, fine = layout.spline.count, layout.spline.finer
    own = _symmetric(optimum.covariance.of_shared[:p, :p])
    values, vectors = np.linalg.eigh(own)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    inner = np.linalg.solve(layout.stiffness_root(optimum.hyperparameters.part_variances), root)
    share, turned = np.linalg.eigh(inner.T @ inner)
    drawn = layout.spline.on_finer @ root @ (turned * np.sqrt(np.clip(share, 0.0, 1.0)))
    covariance = drawn @ drawn.T + np.tensordot(optimum.jumps**2, layout.spline.unseen, 1)
    return UncertainStiffness(
        fine.knots, np.zeros(len(covariance)), _symmetric(covariance), shape=optimum.shape
    ).log_covariance(s)


def without_section_errors(layout: Layout, variances: Array, log_k: Array, covariance: Array) -> tuple[Array, Array]:
    """Mean (p,) and covariance (p, p) of log k's coefficients less the errors of the stated section, from those of the
    coefficients c over the prior's mean; `variances` (n,) are of the prior's parts. Before the data c has covariance S,
    of which P comes from the section. Its share in c is `P S^-1 c`, with covariance `P - P S^-1 P` left open."""
    off, root = layout.section_errors, layout.stiffness_root(variances)
    share = np.linalg.solve(root @ root.T, off).T
    kept = np.eye(len(log_k)) - share
    return kept @ log_k, kept @ covariance @ kept.T + off - share @ off


def power_of_width(layout: Layout, variances: Array, log_k: Array, covariance: Array) -> tuple[float, float]:
    """The power of the body's width that goes into k(s), and its sd, as `without_section_errors`."""
    part, root = layout.spline.parts[:, layout.spline.local.stop], layout.stiffness_root(variances)
    weights = np.linalg.solve(root @ root.T, part)
    left = float(1.0 - weights @ part + weights @ covariance @ weights)
    return POWER * float(weights @ log_k), POWER * max(left, 0.0) ** 0.5


def loop_of(layout: Layout, mean: Array) -> float:
    """Half of the share by which the force differs between a growing and a falling push, the largest of the recordings:
    nobody knows which of both is right, so the gain of the log is known no better."""
    loops = (mean[b.where] for b in layout.blocks if b.name == "hysteresis" and b.start >= 0)
    return max((float(np.abs(one[0])) for one in loops), default=0.0)


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)


LEANS = 4.0  # sds of gravity's written direction, beyond which it is another one


def weight_doubts(mass: LearnedMass | None, leaning: Sequence[float]) -> tuple[str, ...]:
    """What contradicts the weight as written, given the mass after the fit and `leans`; empty as a rule."""
    doubts = []
    if mass is not None and np.isfinite(mass.written) and not optimizer.is_of_a_beam(mass.even / mass.written):
        doubts.append("the beam's weight and the force contradict each other")
    if max((abs(lean) for lean in leaning), default=0.0) > LEANS:
        doubts.append("gravity does not pull where [gravity] says")
    return tuple(doubts)


def leans(data: Sequence[FitData], layout: Layout, mean: Array) -> list[float]:
    """How far off its written direction gravity came out in each recording in which it bends the beam, in sds."""
    found = []
    for one in data:
        block = layout.index.get(("gravity direction", one.number))
        if block is not None and block.start >= 0:
            found.append(float(mean[block.where][0] / block.prior_sd[0]))
    return found


def learned_mass(
    data: Sequence[FitData],
    layout: Layout,
    mean: Array,
    covariance: normal.JointCovariance,
    stiffness: UncertainStiffness,
    gain_sd: float,
) -> LearnedMass | None:
    """The mass after the fit, from mean (P,) and covariance of the parameters; None if nothing weighs or the mass was
    fixed."""
    block, weighed = layout.index["mass", -1], _weighed(data)
    if block.start < 0 or weighed is None:
        return None
    change, spread = mean[block.where], covariance.among(block.where)
    written = np.nan if np.isfinite(weighed.stated.mass_sd) else weighed.stated.mass
    lever = np.array([1.0, 1.0 / 3.0, 0.0, 0.0])  # 2 int s P_i(2 s - 1) ds
    value, s = weighed.stated.mass * (1.0 + float(change[0])), np.linspace(0.0, 1.0, 2001)
    line = mass_per_length(data, layout, mean, stiffness)
    pull = 2.0 * weighed.length * float(np.trapezoid(s * line(s), s))
    if weighed.stated.mass_along != "unknown":
        lever = np.array([pull / value, 0.0, 0.0, 0.0])
    gain = gain_sd if np.isnan(written) else 0.0  # an unknown mass is weighed against the force
    sd = np.sqrt(np.diag(spread)[0] + gain**2)
    even_sd = float(np.sqrt(lever @ spread @ lever + (lever[0] * gain) ** 2))
    return LearnedMass(
        value=value,
        sd=float(weighed.stated.mass * sd),
        even=pull,
        even_sd=weighed.stated.mass * even_sd,
        written=written,
        identified=even_sd < _largest_sd(written, block),
        along=weighed.stated.mass_along,
    )


def mass_per_length(data: Sequence[FitData], layout: Layout, mean: Array, stiffness: UncertainStiffness) -> Profile:
    """kg/m, at parameters (P,)."""
    weighed, change = _weighed(data), layout.get(mean, "mass")
    if weighed is None:
        return Uniform(0.0)
    along = following(weighed, stiffness, weighed.stated.mass * (1.0 + float(change[0])))
    if along is not None:
        return along
    even = weighed.stated.mass / weighed.length
    if weighed.stated.mass_along in ("section", "table"):
        return Scaled(1.0 + float(change[0]), frames.mass_profile(weighed))
    if weighed.stated.mass_line is None:
        return by_legendre(even * (np.array([1.0, 0.0, 0.0, 0.0]) + change))
    s = np.unique(np.concatenate([np.linspace(0.0, 1.0, 101), weighed.stated.mass_line.s]))
    value = frames.mass_profile(weighed)(s) + even * Modes(len(change)).curvature(s) @ change
    return Table(tuple(s.tolist()), tuple(value.tolist()))


def riding_masses(data: Sequence[FitData]) -> tuple[PointMass, ...]:
    """What rides on the beam in every recording of it."""
    first, *others = (one.observations.stated.masses for one in data)
    return tuple(one for one in first if all(one in masses for masses in others))


def _weighed(data: Sequence[FitData]) -> Observations | None:
    return next((r.observations for r in data if np.isfinite(r.observations.stated.mass)), None)


def _largest_sd(written: float, block: Block) -> float:
    if np.isnan(written):
        return KNOWN
    return LEARNED * float(np.hypot(block.prior_sd[0], block.prior_sd[1] / 3.0))


@dataclass(frozen=True)
class Quantities:
    """Numbers that are linear in a block's parameters."""

    labels: tuple[str, ...]
    units: tuple[str, ...]
    weights: Array  # (N, parameters of the block)
    prior_sd: Array  # (N,) before the data, the sizes of a force error integrated out


def quantities(block: Block, data: Sequence[FitData]) -> Quantities:
    """A block's parameters; of a force log's error (a spline in time) mean and drift over the frames of the push."""
    if block.name != "force":
        return Quantities(block.labels, (block.unit,) * len(block.labels), np.eye(len(block.labels)), block.prior_sd)
    one = data[block.recording]
    time = one.observations.time[one.frames]
    time = time - np.mean(time)
    weights = one.error.weights[: len(time)]
    rows = np.stack([np.mean(weights, axis=0), time @ weights / max(float(time @ time), 1e-300)])
    whose = block.labels[0].rpartition(": ")[0]
    names = tuple(f"{whose}: {what} {axis}" for what in ("mean force error", "force drift") for axis in "xy")
    coloured, _, walk, load = np.exp(hyperparameters.SPREAD**2).tolist()  # root mean squares of log-normal factors
    prior = one.error.covariance(coloured, 1.0, walk, load)
    before = np.sqrt(np.einsum("rk,kl,rl->r", rows, prior, rows))
    return Quantities(names, ("N", "N", "N/s", "N/s"), np.kron(rows, np.eye(2)), np.repeat(before, 2))


_HOPELESS_ROUNDS, _HOPELESS_STEPS = 2, 10  # with all frames, where the first ones show that the model cannot be right

STRAYS = 3.0  # times what the pictures' own noise explains: an outline that is farther off is not the body's

Grade = Literal["holds", "holds with allowances", "not to be trusted"]


@dataclass(frozen=True)
class Nuisance:
    """A parameter that is not k(s), with one sd before and after the data."""

    name: str
    unit: str
    value: float
    sd: float
    prior_sd: float


@dataclass(frozen=True)
class Posterior:
    """What the data and the priors say about the beam."""

    problem: linear.FitProblem
    optimum: optimizer.Optimum
    gain_sd: float  # of the force's common scale: as declared, 0 where it was not, and as its loops show
    criticism: Criticism  # whether the model holds
    left_out: tuple[BoolArray, ...]  # (T,) of each recording, poses that no stable equilibrium explains
    place: PlaceSearch | None = None  # other places of the push, where they are worth a look
    contradicted_by: tuple[str, ...] = ()  # names of validations that miss by far more than is likely
    without_outline: str = ""  # the doubt about the fit to outline and tags, after which this is one to the tags alone

    @property
    def recordings(self) -> tuple[FitData, ...]:
        """The recordings as the fit sees them."""
        return self.problem.recordings

    @property
    def layout(self) -> Layout:
        """Where each parameter stands."""
        return self.problem.layout

    @property
    def mean(self) -> Array:
        """(P,) the most probable parameters."""
        return self.optimum.x

    @property
    def covariance(self) -> normal.JointCovariance:
        """Of the parameters (Laplace)."""
        return self.optimum.covariance

    @cached_property
    def slow(self) -> tuple[prediction.Prediction, ...]:
        """The tags of every recording under the logged force less its slow error, each frame's own error left in."""
        pairs = zip(self.recordings, self.optimum.predictions, strict=True)
        return tuple(prediction.predict(recording, self.layout, self.mean, now.solved.q) for recording, now in pairs)

    @cached_property
    def frequencies(self) -> tuple[PredictedFrequencies, ...]:
        """The natural frequencies of each recording that has measured ones, at the optimum."""
        return self.problem.predicted_frequencies(self.mean)

    @cached_property
    def misses(self) -> tuple[optimizer.Miss, ...]:
        """The recordings that the fit cannot explain; empty as a rule."""
        return optimizer.misses(self.recordings, self.slow)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why k(s) and its band are not to be relied on; empty as a rule."""
        several = len(self.recordings) > 1
        doubts = [f"{miss.name}: {miss.words}" if several else miss.words for miss in self.misses]
        if not self.optimum.converged:
            doubts.append("the fit did not converge")
        ideal = not any(recording.allowances for recording in self.recordings)
        if ideal and not self.criticism.trusted:  # nothing in the band allows for what the tests have found
            doubts.append("the recording contradicts the ideal model")
        if (self.place is not None and self.place.accused) or moved_off(self.layout, self.mean) > FAR:
            doubts.append("the stated place of the push (at_s) is wrong")
        pairs = zip(self.recordings, self.optimum.hyperparameters.noise, strict=True)
        noises = [(data.observations, len(data.tags), one.marker) for data, one in pairs]
        if any(o.sd_known and tags < len(o.tag_id) and marker > STRAYS for o, tags, marker in noises):
            doubts.append("the outline contradicts the fit")
        if worst_off(self.frequencies) > GROSS:
            doubts.append("the frequencies contradict the fit")
        doubts += self.weight_doubts
        doubts += [f"the validation on {name} misses by far more than is likely" for name in self.contradicted_by]
        if self.optimum.converged and not self.misses and (doubt := attribution.doubt_of(self.contradictions)):
            doubts.append(doubt)
        for o in (recording.observations for recording in self.recordings):
            doubts += [f"{o.source.name}: {words}" if several else words for words in optimizer.doubts_of(o)]
        return tuple(doubts)

    @cached_property
    def contradictions(self) -> tuple[attribution.Contradiction, ...]:
        """What recording, description and model disagree on, with its size; the largest first."""
        known = stiffness_of(self.problem, self.optimum, self.gain_sd)
        return attribution.contradictions(self.problem, self.optimum, self.criticism, known)

    @cached_property
    def attributions(self) -> tuple[attribution.Attribution, ...]:
        """What everything that the fit allows for does to k(s), where that is known; the largest effect first."""
        s = np.linspace(0.0, 1.0, 101)
        known = stiffness_of(self.problem, self.optimum, self.gain_sd).band(s).identified
        return attribution.attributions(self.problem, self.optimum, self.gain_sd, s[known] if np.any(known) else s)

    @property
    def grade(self) -> Grade:
        """Whether k(s) may be relied on: only gross faults cost that."""
        if self.doubts:
            return "not to be trusted"
        return "holds with allowances" if any(a.matters for a in self.attributions) else "holds"

    @property
    def secant_shares(self) -> tuple[float, ...]:
        """Of each recording: k(s), the secant stiffness, over the instantaneous stiffness; 1 without relaxation."""
        return tuple(prediction.secant_of(p) for p in self.optimum.predictions)

    @property
    def stiffness(self) -> UncertainStiffness:
        """k(s), its band, and the doubts about both; the force's declared gain widens all of it alike."""
        return replace(stiffness_of(self.problem, self.optimum, self.gain_sd), doubts=self.doubts)

    def prior_part(self, s: Array) -> Array:
        """(S, S) the part of log k's covariance at `s` that comes from the prior: recordings of like beams share it."""
        return prior_part(self.problem, self.optimum, s)

    def band(self, s: Array, level: float = 0.95) -> Band:
        """k(s) with its band."""
        return self.stiffness.band(s, level)

    @cached_property
    def mountings(self) -> tuple[float, float, float]:
        """Sd of log k between recordings (RMS along the beam): likely value, and a range of about 80 %; NaN if not
        estimated."""
        factors = sorted(one[BETWEEN] for one in self.optimum.sizes if BETWEEN in one)
        if not factors:
            return np.nan, np.nan, np.nan
        one_sd = float(np.sqrt(np.sum(BETWEEN_SD**2 / (2.0 * np.arange(len(BETWEEN_SD)) + 1.0))))
        return one_sd * float(np.median(factors)), one_sd * factors[0], one_sd * factors[-1]

    @property
    def load_error(self) -> tuple[float, float]:
        """N, sd of the force error that comes with the load, and its share of the largest force, for the recording with
        the largest share; (0, 0) without a force."""
        pushed = [r for r in self.recordings if len(r.error.knots)]
        sizes = [self.optimum.hyperparameters.load * r.error.noise.load for r in pushed]
        forces = [float(np.max(np.linalg.norm(r.force, axis=1))) for r in pushed]
        pairs = [(size, size / force) for size, force in zip(sizes, forces, strict=True)]
        return max(pairs, key=lambda pair: pair[1], default=(0.0, 0.0))

    def reported(self) -> Iterator[tuple[slice, Quantities]]:
        """Where each block but k's and the discrepancy's stands among the parameters, and its quantities."""
        sized = {a.name for one in self.recordings for a in one.allowances if a.enters == "poses" and a.sized}
        for block in self.layout.blocks:
            if block.start >= 0 and block.name not in {"stiffness"} | sized:
                yield block.where, quantities(block, self.recordings)

    def nuisances(self) -> list[Nuisance]:
        """Every parameter but k's and the discrepancy's, before and after the data; of a slow force error mean and
        drift."""
        out = []
        for where, these in self.reported():
            after = np.sqrt(np.diag(these.weights @ self.covariance.among(where) @ these.weights.T))
            value = these.weights @ self.mean[where]
            values = zip(these.labels, these.units, value, after, these.prior_sd, strict=True)
            out += [Nuisance(n, u, float(v), float(s), float(p)) for n, u, v, s, p in values]
        layout, p = self.layout, self.layout.spline.count
        if layout.spline.besides is not None and layout.known is None:
            found = self.mean[:p] - self.problem.level, self.covariance.of_shared[:p, :p]
            power = power_of_width(layout, self.optimum.hyperparameters.part_variances, *found)
            out.append(Nuisance("power of the body's width in k(s)", "1", *power, POWER))
        return out

    @property
    def beam(self) -> Beam:
        """The beam at the optimum."""
        return Beam(
            self.recordings[0].observations.length,
            self.stiffness.profile,
            rest_curvature=by_legendre(self.layout.get(self.mean, "curvature")),
            mass_per_length=mass_per_length(self.recordings, self.layout, self.mean, self.stiffness),
            masses=riding_masses(self.recordings),
        )

    @cached_property
    def weight_doubts(self) -> tuple[str, ...]:
        """What contradicts the weight as written; empty as a rule."""
        return weight_doubts(self.mass, leans(self.recordings, self.layout, self.mean))

    @cached_property
    def mass(self) -> LearnedMass | None:
        """The beam's mass; None where nothing weighs or it was held as written."""
        bare = stiffness_of(self.problem, self.optimum, self.gain_sd)  # its doubts ask for the mass
        return learned_mass(self.recordings, self.layout, self.mean, self.covariance, bare, self.gain_sd)


@one_blas_thread
def fit(
    recordings: Sequence[Observations],
    start: Profile | float | None = None,
    *,
    settings: optimizer.FitSettings = optimizer.FitSettings(),
    gain_sd: float = 0.0,
    progress: Progress = Silent(),
) -> Posterior:
    """Maximum a posteriori over recordings of one beam, from the stiffness `start` [N m] (None: the best uniform beam).
    Raises `LearningError` for recordings of different beams, no usable frame, no equilibrium at the start, force logs
    with more error than force, or equations that cannot be solved."""
    frames.check_same_beam(recordings)
    try:
        some = [recordings[i] for i in optimizer.first_recordings(recordings, settings)]
        begin = start_of(some, None) if start is None else start
        found = _fit(recordings, begin, settings, gain_sd, progress)
        tags = [frames.read_alone(one) for one in recordings]
        own = any(map(optimizer.doubts_of, recordings))  # which no other fit takes away
        if any(map(_beside_tags, recordings)) and found.doubts and not own:
            return replace(_fit(tags, begin, settings, gain_sd, progress), without_outline=found.doubts[0])
        return found
    except np.linalg.LinAlgError as error:
        names = ", ".join(one.source.name for one in recordings)
        raise LearningError(
            f"{names}: the equations of the fit cannot be solved ({error}). Look at the force and the tags with "
            "`onebend learn --method regression`"
        ) from error


def _beside_tags(one: Observations) -> bool:
    """Whether there are points of an outline, and tags."""
    return 0 < int(np.sum(tags_among(one))) < len(one.tag_id)


def _fit(
    recordings: Sequence[Observations],
    start: Profile | float,
    settings: optimizer.FitSettings,
    gain_sd: float,
    progress: Progress,
) -> Posterior:
    late = replace(settings.optimizer, coarse_rounds=0, rounds=settings.last_rounds)
    early = replace(settings.optimizer, tolerance=settings.optimizer.on_the_way, rounds=settings.first_rounds)
    progress.start("fitting k(s) in marker space", early.rounds + late.rounds)

    settings = optimizer.shared_among(settings, len(recordings))
    recordings = with_shared_shape([condensed(one) for one in recordings])
    some = optimizer.first_recordings(recordings, settings)
    problem, x = optimizer.first_problem([recordings[i] for i in some], start, settings)
    few, near = optimizer.find_on_branches(problem, optimizer.estimate_at(problem, x), early, progress)
    hopeless = any(miss.hopeless for miss in optimizer.misses(few.recordings, near.predictions))
    if hopeless:  # nothing that is fitted means anything: a short look at all frames says so as clearly
        late = replace(late, rounds=_HOPELESS_ROUNDS, most_steps=_HOPELESS_STEPS)
    recordings, near = optimizer.with_mass_found(recordings, problem, near)

    every = optimizer.whole_problem(recordings, problem, settings)
    begin = optimizer.carried_over(few, near, every, some)
    del problem, few, near
    whole, estimate = optimizer.find_on_branches(every, begin, late, progress)
    optimum = optimizer.laplace_posterior(whole, estimate, late)
    gain_sd = float(np.hypot(gain_sd, loop_of(whole.layout, optimum.x)))
    found = stiffness_of(whole, optimum, gain_sd)
    critic = criticise(whole, optimum, found)
    known = bool(np.any(found.band(np.linspace(0.0, 1.0, 101)).identified))
    ask = optimum.converged and (known or bool(critic.striking))
    place = search_place(whole, optimum, settings, thorough=doubtful(critic) and not hopeless) if ask else None
    progress.done()
    left_out = tuple(a.frames & ~b.frames for a, b in zip(every.recordings, whole.recordings, strict=True))
    optimum = with_places(whole, optimum, place, found.log_at(SHAPE_PLACES)[1])
    return Posterior(whole, optimum, gain_sd, critic, left_out, place)


# Correlations of the posterior. Of two strongly correlated quantities the data fix one combination.

LEVEL = "mean log k(s)"


@dataclass(frozen=True)
class Tradeoff:
    """Two quantities that the data hardly tell apart."""

    first: str
    second: str
    correlation: float  # of the posterior, in [-1, 1]


def tradeoffs(posterior: Posterior, *, most: int = 5, least: float = 0.5) -> tuple[Tradeoff, ...]:
    """The strongest pairs first: at most `most`, none weaker than `least`. Every quantity appears once."""
    names, correlation = correlations(posterior)
    first, second = np.triu_indices(len(names), k=1)
    strength = np.abs(correlation[first, second])
    found: list[Tradeoff] = []
    named: set[int] = set()
    for i in np.argsort(-strength, kind="stable"):
        if strength[i] < least or len(found) == most:
            break
        if not named & {int(first[i]), int(second[i])}:
            found.append(Tradeoff(names[first[i]], names[second[i]], float(correlation[first[i], second[i]])))
            named |= {int(first[i]), int(second[i])}
    return tuple(found)


def with_level(posterior: Posterior, *, most: int = 3, least: float = 0.1) -> tuple[Tradeoff, ...]:
    """What the level of k(s) itself trades off against, strongest first."""
    names, correlation = correlations(posterior)
    order = [i for i in np.argsort(-np.abs(correlation[0, 1:])) + 1 if abs(correlation[0, i]) >= least][:most]
    return tuple(Tradeoff(LEVEL, names[i], float(correlation[0, i])) for i in order)


def correlations(posterior: Posterior) -> tuple[list[str], Array]:
    """Names (N,) and correlations (N, N) of the quantities; the mean of log k(s) comes first."""
    names, rows = [LEVEL], [(slice(0, posterior.layout.shared), _level(posterior)[None])]
    for where, these in posterior.reported():
        names += these.labels
        rows.append((where, these.weights))
    covariance = posterior.covariance.of_functionals(rows)
    sd = np.sqrt(np.diag(covariance))
    return names, np.asarray(covariance / np.outer(sd, sd))


def _level(posterior: Posterior) -> Array:
    """(n,) weights of the shared parameters in the mean of log k, over the identified places if there are any."""
    s = np.linspace(0.0, 1.0, 201)
    identified = posterior.band(s).identified
    index, onto = linear.log_k_map(posterior.problem)
    basis = posterior.layout.spline.finer.basis(s[identified] if np.any(identified) else s) @ onto
    out = np.zeros(posterior.layout.shared)
    out[index] = np.mean(basis, axis=0)
    return out
