"""k(s) with a band: maximum a posteriori in marker space, through the exact equilibrium.

Unknown are log k(s), the beam's rest shape, where and how each tag sits, the clamp's direction and place, the clock's
rest error, and the slow error of the force log. Seen are the tags of every loaded frame, of the beam at rest, and the
force log where nothing pushes. All of it is fitted together; the scales of priors and noise are chosen by evidence;
the band comes from the curvature at the optimum (Laplace's approximation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from onebend.beam.modal import Modes
from onebend.beam.model import Beam
from onebend.beam.profiles.stiffness import Powers, Profile, Scaled, Table, Uniform
from onebend.beam.profiles.uncertain import Band, UncertainStiffness
from onebend.blas import one_blas_thread
from onebend.errors import LearningError
from onebend.learning.criticism.criticism import Criticism, criticise
from onebend.learning.inference.hyperparameters import noise_before
from onebend.learning.inference.linear_gaussian import Scales
from onebend.learning.inference.misfit import Miss, misses
from onebend.learning.inference.nuisances import quantities
from onebend.learning.inference.optimizer import Effort, Optimum, conclude, search
from onebend.learning.model.fit_data import Film, film
from onebend.learning.model.forward import Prediction, predict
from onebend.learning.model.frames import check_same_beam, chosen_frames, mass_profile
from onebend.learning.model.mass import KNOWN, TOLD, LearnedMass
from onebend.learning.model.own_weight import following
from onebend.learning.model.parameters import Block, Layout, Priors, layout
from onebend.learning.model.spline import RHO, TAU, Spline
from onebend.progress import Progress, Silent
from onebend.records import Array, Observations

CONTRADICTED = "the force contradicts the bending"


@dataclass(frozen=True)
class FitSettings:
    """How the marker-space fit runs."""

    functions: int = 45  # of the spline of log k
    most_frames: int = 500  # of each recording, evenly chosen
    first_frames: int = 100  # of each recording, for the way from the start to near the optimum
    priors: Priors = field(default_factory=Priors)
    effort: Effort = field(default_factory=Effort)
    last_rounds: int = 6  # at most, with all frames


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

    at: Layout
    films: tuple[Film, ...]
    optimum: Optimum
    gain_sd: float  # of the force's common scale, as declared; 0 where it was not
    criticism: Criticism  # whether the model holds

    @property
    def mean(self) -> Array:
        """(P,) the most probable parameters."""
        return self.optimum.x

    @property
    def covariance(self) -> Array:
        """(P, P) of the parameters (Laplace)."""
        return self.optimum.covariance

    @cached_property
    def slow(self) -> tuple[Prediction, ...]:
        """The tags of every film with the slow error of its force log taken off, and each frame's own left in."""
        every = zip(self.films, self.optimum.predictions, strict=True)
        return tuple(predict(film, self.at, self.mean, found.solved.q) for film, found in every)

    @cached_property
    def misses(self) -> tuple[Miss, ...]:
        """The recordings that the fit cannot explain; empty as a rule."""
        return misses(self.films, self.slow)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why k(s) and its band are not to be relied on; empty as a rule."""
        several = len(self.films) > 1
        found = [f"{one.name}: {one.words}" if several else one.words for one in self.misses]
        if not self.optimum.converged:
            found.append("the fit did not converge")
        if not self.criticism.trusted:
            found.append("the recording contradicts the model of the fit")
        for o in (one.observations for one in self.films):
            if any(remark.doubt for remark in o.source.remarks):
                found.append(f"{o.source.name}: {CONTRADICTED}" if several else CONTRADICTED)
        return tuple(found)

    @property
    def stiffness(self) -> UncertainStiffness:
        """k(s) and its band, with what speaks against both; the force's declared gain widens all of it alike."""
        return replace(stiffness_of(self.at, self.optimum, self.gain_sd), doubts=self.doubts)

    def band(self, s: Array, level: float = 0.95) -> Band:
        """k(s) with its band."""
        return self.stiffness.band(s, level)

    @property
    def load_error(self) -> tuple[float, float]:
        """N, one sd of the force error that comes with the load, as the data chose it, and its share of the largest
        force; those of the recording where the share is largest, (0, 0) without a force."""
        sizes = [self.optimum.scales.load * f.error.load for f in self.films if len(f.error.knots)]
        forces = [float(np.max(np.linalg.norm(f.force, axis=1))) for f in self.films if len(f.error.knots)]
        pairs = [(size, size / force) for size, force in zip(sizes, forces, strict=True)]
        return max(pairs, key=lambda pair: pair[1], default=(0.0, 0.0))

    def nuisances(self) -> list[Nuisance]:
        """Every parameter but k's, before and after the data; of the force's slow error its mean and drift."""
        out = []
        for block in self.at.blocks:
            if block.start < 0 or block.name == "stiffness":
                continue
            these, where = quantities(block, self.films), block.where
            after = np.sqrt(np.diag(these.weights @ self.covariance[where, where] @ these.weights.T))
            value = these.weights @ self.mean[where]
            values = zip(these.labels, these.units, value, after, these.prior_sd, strict=True)
            out += [Nuisance(n, u, float(v), float(s), float(p)) for n, u, v, s, p in values]
        return out

    @property
    def beam(self) -> Beam:
        """The beam at the optimum."""
        one = self.films[0].observations
        return Beam(
            one.length,
            self.stiffness.profile,
            rest_curvature=_from_legendre(self.at.get(self.mean, "curvature")),
            mass_per_length=self._mass_per_length(),
        )

    @property
    def mass(self) -> LearnedMass | None:
        """The beam's mass; None where nothing weighs or it was held as written."""
        block, weighed = self.at.index["mass", -1], self._weighed()
        if block.start < 0 or weighed is None:
            return None
        change, left = self.mean[block.where], self.covariance[block.where, block.where]
        written = np.nan if np.isfinite(weighed.stated.mass_sd) else weighed.stated.mass
        lever = np.array([1.0, 1.0 / 3.0, 0.0, 0.0])  # 2 int s P_i(2 s - 1) ds
        value, s = weighed.stated.mass * (1.0 + float(change[0])), np.linspace(0.0, 1.0, 2001)
        pull = 2.0 * weighed.length * float(np.trapezoid(s * self._mass_per_length()(s), s))
        if weighed.stated.mass_along != "unknown":
            lever = np.array([pull / value, 0.0, 0.0, 0.0])
        gain = self.gain_sd if np.isnan(written) else 0.0  # an unknown mass is weighed against the force
        sd = np.sqrt(np.diag(left)[0] + gain**2)
        even_sd = float(np.sqrt(lever @ left @ lever + (lever[0] * gain) ** 2))
        return LearnedMass(
            value=value,
            sd=float(weighed.stated.mass * sd),
            even=pull,
            even_sd=weighed.stated.mass * even_sd,
            written=written,
            identified=even_sd < self._told(written, block),
            along=weighed.stated.mass_along,
        )

    def _told(self, written: float, block: Block) -> float:
        """How sure the mass must come out, over itself, to count as learned."""
        if np.isnan(written):
            return KNOWN
        before = np.hypot(block.prior_sd[0], block.prior_sd[1] / 3.0)
        return TOLD * float(before)

    def _weighed(self) -> Observations | None:
        """The recording whose mass the fit changed."""
        return next((f.observations for f in self.films if np.isfinite(f.observations.stated.mass)), None)

    def _mass_per_length(self) -> Profile:
        """kg/m: what was written down and what the fit changed of it."""
        weighed, change = self._weighed(), self.at.get(self.mean, "mass")
        if weighed is None:
            return Uniform(0.0)
        along = following(weighed, self.stiffness, weighed.stated.mass * (1.0 + float(change[0])))
        if along is not None:
            return along
        even = weighed.stated.mass / weighed.length
        if weighed.stated.mass_along == "table":
            return Scaled(1.0 + float(change[0]), mass_profile(weighed))
        if weighed.stated.mass_line is None:
            return _from_legendre(even * (np.array([1.0, 0.0, 0.0, 0.0]) + change))
        s = np.unique(np.concatenate([np.linspace(0.0, 1.0, 101), weighed.stated.mass_line.s]))
        value = mass_profile(weighed)(s) + even * Modes(len(change)).curvature(s) @ change
        return Table(tuple(s.tolist()), tuple(value.tolist()))


def stiffness_of(at: Layout, optimum: Optimum, gain_sd: float) -> UncertainStiffness:
    """k(s) and its band at an optimum: also where, within its knots, the spline cannot tell a step to be."""
    where, fine, onto = at.index["stiffness", -1].where, at.spline.finer, at.spline.on_finer
    covariance = onto @ optimum.covariance[where, where] @ onto.T
    covariance += np.tensordot(optimum.jumps**2, at.spline.unseen, 1)
    covariance = 0.5 * (covariance + covariance.T)
    return UncertainStiffness(fine.knots, onto @ optimum.x[where], covariance, gain_sd, shape=optimum.shape)


def _from_legendre(states: Array) -> Profile:
    """The profile of Legendre states."""
    if np.all(states[1:] == 0.0):
        return Uniform(float(states[0]))
    return Powers(tuple(np.linalg.solve(Modes(len(states), "powers").to_legendre, states).tolist()))


@one_blas_thread
def fit(
    recordings: Sequence[Observations],
    start: Profile | float,
    *,
    settings: FitSettings = FitSettings(),
    gain_sd: float = 0.0,
    progress: Progress = Silent(),
) -> Posterior:
    """Maximum a posteriori over one or several recordings of the same beam, from a stiffness to begin with.

    Raises:
        LearningError: recordings of different beams, no usable frame, a start from which no equilibrium is found, or
            equations that rounding makes unsolvable.
    """
    check_same_beam(recordings)
    try:
        return _fit(recordings, start, settings, gain_sd, progress)
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
    spline = Spline(settings.functions)
    first, films = (_films(recordings, most, spline) for most in (settings.first_frames, settings.most_frames))
    at = layout(spline, list(recordings), [len(f.error.knots) for f in films], settings.priors)
    x, level = _start(at, start)
    expected = Scales(spline.variances(TAU, RHO), 1.0, 1.0, 1.0, 1.0, tuple(noise_before(f) for f in films))
    end = replace(settings.effort, coarse_rounds=0, rounds=settings.last_rounds)
    way = replace(settings.effort, tolerance=settings.effort.on_the_way)
    progress.start("fitting k(s) in marker space", way.rounds + end.rounds)
    near = search(first, at, x, level, expected, expected, way, progress)
    if any(np.isfinite(o.stated.mass_sd) for o in recordings):  # a guessed mass: its unevenness counts over what it is
        mass = at.index["mass", -1].where
        more = 1.0 + max(float(near.x[mass.start]), -0.9)
        x = near.x.copy()
        x[mass] = (x[mass] + np.array([1.0, 0.0, 0.0, 0.0])) / more - np.array([1.0, 0.0, 0.0, 0.0])
        near = replace(near, x=x)
        heavier = [replace(o, stated=replace(o.stated, mass=more * o.stated.mass)) for o in recordings]
        films = _films(heavier, settings.most_frames, spline)
    same = all(np.array_equal(one.frames, other.frames) for one, other in zip(first, films, strict=True))
    shapes = [p.solved.q for p in near.predictions] if same else None
    found = search(films, at, near.x, level, near.scales, expected, end, progress, shapes)
    optimum = conclude(films, at, replace(found, steps=near.steps + found.steps), level, expected, end)
    progress.done()
    criticism = criticise(films, at, optimum, level, stiffness_of(at, optimum, gain_sd))
    return Posterior(at, tuple(films), optimum, gain_sd, criticism)


def _films(recordings: Sequence[Observations], most: int, spline: Spline) -> list[Film]:
    return [film(o, i, chosen_frames(o, most), spline) for i, o in enumerate(recordings)]


def _start(at: Layout, start: Profile | float) -> tuple[Array, float]:
    """Parameters and the level of log k to begin with."""
    s = np.linspace(0.0, 1.0, 8 * at.spline.count)
    k = np.full(len(s), float(start)) if isinstance(start, float | int) else np.asarray(start(s))
    if not np.all(k > 0.0):
        raise LearningError("the start stiffness must be positive everywhere")
    x = np.zeros(at.size)
    x[: at.spline.count] = np.linalg.lstsq(at.spline.basis(s), np.log(k), rcond=None)[0]
    return x, float(np.mean(np.log(k)))
