"""k(s) with a band: maximum a posteriori in marker space, through the exact equilibrium.

The parameters are log k(s), the beam's rest shape, where and how each tag sits, the clamp's direction and place, the
clock offset that is left, and the slow error of the force log. The data are the tags of every loaded frame, of the beam
at rest, and the force log where nothing pushes. All parameters are fitted together; the hyperparameters of priors and
noise are chosen by evidence; the band comes from the curvature at the optimum (Laplace's approximation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.stiffness import Profile
from onebend.beam.profiles.uncertain import SHAPE_PLACES, Band, UncertainStiffness
from onebend.blas import one_blas_thread
from onebend.errors import LearningError
from onebend.learning.allowances.mounting import BETWEEN, BETWEEN_SD
from onebend.learning.attribution import Attribution, attributions
from onebend.learning.criticism.criticism import Criticism, criticise
from onebend.learning.criticism.push_place import FAR, PlaceSearch, doubtful, moved_off, search_place, with_places
from onebend.learning.frequencies.compared import GROSS, worst_off
from onebend.learning.frequencies.modes import with_modes
from onebend.learning.frequencies.predicted import PredictedFrequencies
from onebend.learning.inference.fit_problem import FitProblem
from onebend.learning.inference.joint_covariance import JointCovariance
from onebend.learning.inference.misfit import Miss, doubts_of, misses
from onebend.learning.inference.nuisances import quantities
from onebend.learning.inference.optimizer import (
    Optimum,
    estimate_at,
    laplace_posterior,
)
from onebend.learning.inference.pose_branches import find_on_branches
from onebend.learning.inference.stages import (
    FitSettings,
    carried_over,
    first_problem,
    first_recordings,
    shared_among,
    whole_problem,
    with_mass_found,
)
from onebend.learning.known_shape import with_shared_shape
from onebend.learning.learned_mass import (
    from_legendre,
    leans,
    learned_mass,
    mass_per_length,
    riding_masses,
    weight_doubts,
)
from onebend.learning.model.allowed import secant_of
from onebend.learning.model.condensed import condensed
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.forward import Prediction, predict
from onebend.learning.model.frames import check_same_beam
from onebend.learning.model.mass import LearnedMass
from onebend.learning.model.parameters import Layout
from onebend.learning.start import start_of
from onebend.learning.stiffness_band import prior_part, stiffness_of
from onebend.progress import Progress, Silent
from onebend.records import Array, BoolArray, Observations

_HOPELESS_ROUNDS, _HOPELESS_STEPS = 2, 10  # with all frames, where the first ones show that the model cannot be right

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

    problem: FitProblem
    optimum: Optimum
    gain_sd: float  # of the force's common scale, as declared; 0 where it was not
    criticism: Criticism  # whether the model holds
    left_out: tuple[BoolArray, ...]  # (T,) of each recording, poses that no stable equilibrium explains
    place: PlaceSearch | None = None  # other places of the push, where they are worth a look

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
    def covariance(self) -> JointCovariance:
        """Of the parameters (Laplace)."""
        return self.optimum.covariance

    @cached_property
    def slow(self) -> tuple[Prediction, ...]:
        """The tags of every recording under the logged force less its slow error, each frame's own error left in."""
        pairs = zip(self.recordings, self.optimum.predictions, strict=True)
        return tuple(predict(recording, self.layout, self.mean, now.solved.q) for recording, now in pairs)

    @cached_property
    def frequencies(self) -> tuple[PredictedFrequencies, ...]:
        """The natural frequencies of each recording that has measured ones, at the optimum."""
        return self.problem.predicted_frequencies(self.mean)

    @cached_property
    def misses(self) -> tuple[Miss, ...]:
        """The recordings that the fit cannot explain; empty as a rule."""
        return misses(self.recordings, self.slow)

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
            doubts.append("the push hardly acts where at_s says")
        if worst_off(self.frequencies) > GROSS:
            doubts.append("the frequencies contradict the fit")
        doubts += self.weight_doubts
        for o in (recording.observations for recording in self.recordings):
            doubts += [f"{o.source.name}: {words}" if several else words for words in doubts_of(o)]
        return tuple(doubts)

    @cached_property
    def attributions(self) -> tuple[Attribution, ...]:
        """What everything that the fit allows for does to k(s), where that is known; the largest effect first."""
        s = np.linspace(0.0, 1.0, 101)
        known = stiffness_of(self.problem, self.optimum, self.gain_sd).band(s).identified
        return attributions(self.problem, self.optimum, self.gain_sd, s[known] if np.any(known) else s)

    @property
    def grade(self) -> Grade:
        """Whether k(s) may be relied on: only gross faults cost that."""
        if self.doubts:
            return "not to be trusted"
        return "holds with allowances" if any(a.matters for a in self.attributions) else "holds"

    @property
    def secant_shares(self) -> tuple[float, ...]:
        """Of each recording: k(s), the secant stiffness of its push, over the instantaneous stiffness; 1 where the
        material does not relax."""
        return tuple(secant_of(p.recording, p.layout, p.x, p.solved) for p in self.optimum.predictions)

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
        """Between recordings, one sd of log k over the beam (root mean square): the likely one, and a range of about
        80 %; NaN where it was not looked at, as of one recording."""
        factors = sorted(one[BETWEEN] for one in self.optimum.sizes if BETWEEN in one)
        if not factors:
            return np.nan, np.nan, np.nan
        one_sd = float(np.sqrt(np.sum(BETWEEN_SD**2 / (2.0 * np.arange(len(BETWEEN_SD)) + 1.0))))
        return one_sd * float(np.median(factors)), one_sd * factors[0], one_sd * factors[-1]

    @property
    def load_error(self) -> tuple[float, float]:
        """N, one sd of the force error that comes with the load, as the data chose it, and its share of the largest
        force; those of the recording where the share is largest, (0, 0) without a force."""
        pushed = [r for r in self.recordings if len(r.error.knots)]
        sizes = [self.optimum.hyperparameters.load * r.error.load for r in pushed]
        forces = [float(np.max(np.linalg.norm(r.force, axis=1))) for r in pushed]
        pairs = [(size, size / force) for size, force in zip(sizes, forces, strict=True)]
        return max(pairs, key=lambda pair: pair[1], default=(0.0, 0.0))

    def nuisances(self) -> list[Nuisance]:
        """Every parameter but k's and the discrepancy's, before and after the data; of the force's slow error its mean
        and drift."""
        out = []
        left_out = {"stiffness"} | {
            a.name for recording in self.recordings for a in recording.allowances if a.enters == "poses" and a.sized
        }
        for block in self.layout.blocks:
            if block.start < 0 or block.name in left_out:
                continue
            these, where = quantities(block, self.recordings), block.where
            after = np.sqrt(np.diag(these.weights @ self.covariance.among(where) @ these.weights.T))
            value = these.weights @ self.mean[where]
            values = zip(these.labels, these.units, value, after, these.prior_sd, strict=True)
            out += [Nuisance(n, u, float(v), float(s), float(p)) for n, u, v, s, p in values]
        return out

    @property
    def beam(self) -> Beam:
        """The beam at the optimum."""
        return Beam(
            self.recordings[0].observations.length,
            self.stiffness.profile,
            rest_curvature=from_legendre(self.layout.get(self.mean, "curvature")),
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
    settings: FitSettings = FitSettings(),
    gain_sd: float = 0.0,
    progress: Progress = Silent(),
) -> Posterior:
    """Maximum a posteriori over one or several recordings of the same beam.

    It begins at the stiffness `start` [N m]; None: at that of the uniform beam that is nearest to the tags.

    Raises:
        LearningError: recordings of different beams, no usable frame, a start from which no equilibrium is found,
            force logs with more error than force, or equations that rounding makes unsolvable.
    """
    check_same_beam(recordings)
    recordings = with_modes(recordings)
    try:
        some = [recordings[i] for i in first_recordings(recordings, settings)]
        begin = start_of(some, None) if start is None else start
        return _fit(recordings, begin, settings, gain_sd, progress)
    except np.linalg.LinAlgError as error:
        names = ", ".join(one.source.name for one in recordings)
        raise LearningError(
            f"{names}: the equations of the fit cannot be solved ({error}). Look at the force and the tags with "
            "`onebend learn --method regression`"
        ) from error


def _fit(
    recordings: Sequence[Observations],
    start: Profile | float,
    settings: FitSettings,
    gain_sd: float,
    progress: Progress,
) -> Posterior:
    """Data, problem, start, optimum, posterior, criticism: first with a few frames of each recording, then with all."""
    late = replace(settings.optimizer, coarse_rounds=0, rounds=settings.last_rounds)
    early = replace(settings.optimizer, tolerance=settings.optimizer.on_the_way, rounds=settings.first_rounds)
    progress.start("fitting k(s) in marker space", early.rounds + late.rounds)

    settings = shared_among(settings, len(recordings))
    recordings = with_shared_shape([condensed(one, settings.most_frames) for one in recordings])
    some = first_recordings(recordings, settings)
    problem, x = first_problem([recordings[i] for i in some], start, settings)
    few, near = find_on_branches(problem, estimate_at(problem, x), early, progress)
    hopeless = any(miss.hopeless for miss in misses(few.recordings, near.predictions))
    if hopeless:  # nothing that is fitted means anything: a short look at all frames says so as clearly
        late = replace(late, rounds=_HOPELESS_ROUNDS, most_steps=_HOPELESS_STEPS)
    recordings, near = with_mass_found(recordings, problem, near)

    every = whole_problem(recordings, problem, settings)
    begin = carried_over(few, near, every, some)
    del problem, few, near
    whole, estimate = find_on_branches(every, begin, late, progress)
    optimum = laplace_posterior(whole, estimate, late)
    found = stiffness_of(whole, optimum, gain_sd)
    critic = criticise(whole, optimum, found)
    known = bool(np.any(found.band(np.linspace(0.0, 1.0, 101)).identified))
    ask = optimum.converged and (known or bool(critic.striking))
    place = search_place(whole, optimum, settings, thorough=doubtful(critic) and not hopeless) if ask else None
    progress.done()
    left_out = tuple(a.frames & ~b.frames for a, b in zip(every.recordings, whole.recordings, strict=True))
    optimum = with_places(whole, optimum, place, found.log_at(SHAPE_PLACES)[1])
    return Posterior(whole, optimum, gain_sd, critic, left_out, place)
