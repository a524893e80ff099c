"""The beam as a force sensor: the force on a beam whose k(s) is known, from its shape, frame by frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.stats import chi2

from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.beam.statics.rod import has_mass
from onebend.blas import one_blas_thread
from onebend.errors import LearningError
from onebend.learning.design.instruments import Instruments
from onebend.learning.model.frames import evenly_spread
from onebend.learning.model.mass import NEEDS_MASS, weighs
from onebend.learning.sensing.bench import Bench, make_bench
from onebend.learning.sensing.estimate import Estimates, estimate
from onebend.learning.sensing.misfit import Misfit, misfit
from onebend.records import Array, BoolArray, IntArray, Observations, Remark

LEVEL = 0.95
PRIOR_SHARE = 3.0  # of k/L: the prior's sd of each component of the force
_TOUCH = float(chi2.ppf(LEVEL, 2))
_RUN = 3  # frames in a row that show a force, before it is a contact
_EVERY = 8  # frames of the first look, from which the others begin
_SCAN = np.linspace(0.2, 1.0, 9)  # places where the search for the contact begins
_AS_WELL = float(chi2.ppf(LEVEL, 1))  # of the objective: two places explain a frame about as well
_APART = 0.1  # of the beam: closer places are one
_PLACE_KNOWN = 0.1  # sd of s beyond which the place of the contact is not told
_LOOKED_AT = 12  # frames, for the misfit
_TOO_FAR, _UNLIKELY = 2.5, 1e-4  # of the misfit: its ratio and probability from which it is a warning
_FROM_PRIOR = 0.25  # share of a component's variance left by the data from which it is said


@dataclass(frozen=True)
class SenseSettings:
    """What is known of the contact, and of forces before any shape was seen."""

    place: Literal["known", "unknown"] = "known"
    at_s: float | None = None  # where the force acts; None: as the recording says
    at_sd: float | None = None  # m, one sd of that place; None: as the recording says
    # N, one sd of each component before the shape is seen, mean zero; None: three times k/L, mean along the beam
    force_prior: float | None = None
    # whether the tags sit on the beam as they did when it was learned; "anew": they were put on again
    tags: Literal["as learned", "anew"] = "as learned"


@dataclass(frozen=True)
class Touch:
    """A stretch of frames that show a force: its first and last time."""

    begin: float  # s
    end: float  # s


@dataclass(frozen=True)
class Sensed:
    """The force on the beam in T frames, beam's frame; NaN where a frame tells nothing."""

    name: str
    settings: SenseSettings
    prior_sd: float  # N
    frame: IntArray  # (T,) index in the video
    time: Array  # (T,) s
    force: Array  # (T, 2) N
    covariance: Array  # (T, 2, 2) N^2
    prior_share: Array  # (T, 2) of each component's prior variance, what the data leave: 1 is the prior alone
    place: Array  # (T,) s; NaN where it was sought and not found
    place_sd: Array  # (T,) of s
    other_place: Array  # (T,) s that explains the frame about as well; NaN where there is none
    weak_angle: Array  # (T,) rad, the direction in which the force is known least, against x, in [0, pi)
    weak_sd: Array  # (T,) N, in that direction
    strong_sd: Array  # (T,) N, across it
    chi2: Array  # (T,) squared residuals in units of all noise
    touched: BoolArray  # (T,) zero force lies outside the 95 % region
    contacts: tuple[Touch, ...]
    misfit: Misfit | None  # None: no frame shows a force
    logged: Array  # (T, 2) N, as the recording's log says; NaN where it has none
    remarks: tuple[Remark, ...] = ()

    @property
    def peak(self) -> int | None:
        """Index of the largest force among the frames of a contact; None where there is none."""
        inside = np.zeros(len(self.time), dtype=bool)
        for one in self.contacts:
            inside |= (self.time >= one.begin) & (self.time <= one.end)
        size = np.where(inside & self.touched, np.hypot(*self.force.T), -1.0)
        return int(np.argmax(size)) if np.any(size > 0.0) else None

    @property
    def against_log(self) -> tuple[float, float] | None:
        """N, RMS over the touched frames of the difference to the log: in the direction in which the force is known
        best, and in that in which least. None where there is no log, or no frame that shows a force."""
        shown = self.touched & np.isfinite(self.logged).all(axis=1)
        if not np.any(shown):
            return None
        away, angle = (self.force - self.logged)[shown], self.weak_angle[shown]
        least = away[:, 0] * np.cos(angle) + away[:, 1] * np.sin(angle)
        best = away[:, 1] * np.cos(angle) - away[:, 0] * np.sin(angle)
        return float(np.sqrt(np.mean(best**2))), float(np.sqrt(np.mean(least**2)))

    def along(self, angle: Array | float) -> tuple[Array, Array]:
        """(T,) N each: the force in the direction `angle` [rad] against x, and its sd."""
        way = np.broadcast_to(np.stack([np.cos(angle), np.sin(angle)], axis=-1), self.force.shape)
        variance = np.einsum("tc,tcd,td->t", way, self.covariance, way)
        return np.einsum("tc,tc->t", way, self.force), np.sqrt(variance)


@one_blas_thread
def sense(
    beam: Beam,
    observations: Observations,
    *,
    stiffness: UncertainStiffness | None = None,
    instruments: Instruments | None = None,
    settings: SenseSettings = SenseSettings(),
) -> Sensed:
    """The force of every frame that shows tags, with a 95 % region, from the shape of `beam`.

    The regions hold the tags' noise, the band of k(s) where `stiffness` gives one, the mounting (the tags' places and
    turns, the clamp, the rest shape) as it is left by the frames at rest, and the place's tolerance. The force log is
    not used but to compare with. `instruments` are those of the model: where the recording has the same tags, their
    places and turns are as they were learned, together with the errors of k(s); what the learning left unexplained (its
    discrepancy) counts in any case.

    Raises:
        LearningError: the beam is not that of the recording, its end is held, nobody says where the force acts, or no
            frame shows a tag.
        MechanicsError: k(s) is not positive somewhere.
    """
    o = observations
    _check(beam, o, settings)
    tells: BoolArray = np.sum(np.isfinite(o.xy), axis=(1, 2)) >= 2
    frames = np.flatnonzero(tells).astype(np.int64)
    if not frames.size:
        raise LearningError(f"{o.source.name}: no frame shows a tag of the beam, so no force can be told")
    mean_k = float(np.mean(np.asarray(beam.stiffness(np.linspace(0.0, 1.0, 101)))))
    prior = PRIOR_SHARE * mean_k / beam.length if settings.force_prior is None else settings.force_prior
    place_sd = o.stated.place_sd if settings.at_sd is None else settings.at_sd
    bench = make_bench(beam, o, stiffness, place_sd, instruments, tags_as_learned=settings.tags == "as learned")
    if settings.place == "known":
        found, other = _at_known_place(bench, frames, _places(o, frames, settings), prior), np.full(len(frames), np.nan)
    else:
        found, other = _at_unknown_place(bench, frames, prior)
    return _sensed(bench, frames, found, other, prior, settings)


def _check(beam: Beam, o: Observations, settings: SenseSettings) -> None:
    if abs(beam.length - o.length) > 1e-6 * o.length:
        raise LearningError(
            f"{o.source.name}: the model's beam is {1e3 * beam.length:.6g} mm long, the recording's "
            f"{1e3 * o.length:.6g} mm. Give the model of this beam"
        )
    if o.held is not None:
        raise LearningError(
            f"{o.source.name}: the end of the beam is held; a force is told from the shape of a beam that is free there"
        )
    if weighs(o) and not has_mass(beam):
        raise LearningError(f"{o.source.name}: {NEEDS_MASS}")
    if settings.at_s is not None and not 0.0 < settings.at_s <= 1.0:
        raise LearningError(f"a force acts at s in (0, 1], got {settings.at_s}")
    if settings.place == "unknown" and not (settings.at_s is None and settings.at_sd is None):
        raise LearningError("the place of the contact is either said or sought: leave out where it is, or 'unknown'")
    for what, value in (("the place's sd", settings.at_sd), ("the force's prior sd", settings.force_prior)):
        if value is not None and not (math.isfinite(value) and value >= 0.0):
            raise LearningError(f"{what} must be a finite number above zero, got {value}")
    if settings.force_prior == 0.0:
        raise LearningError("a force prior of 0 N says that there is no force: give the size of forces to be expected")


def _places(o: Observations, frames: IntArray, settings: SenseSettings) -> Array:
    """(F,) where the force acts; frames of which nobody says it take the usual place."""
    if settings.at_s is not None:
        return np.full(len(frames), settings.at_s)
    said = o.push_s[frames]
    if not np.isfinite(said).any():
        raise LearningError(
            f"{o.source.name}: nobody says where the force acts. Write [push] in recording.toml, give its place "
            "(--push-at), or let it be sought (--place unknown)"
        )
    return np.where(np.isfinite(said), said, np.nanmedian(said))


def _at_known_place(bench: Bench, frames: IntArray, place: Array, prior: float) -> Estimates:
    """Some frames first; the others begin at the forces between."""
    some = np.unique(np.append(np.arange(0, len(frames), _EVERY), len(frames) - 1))
    first = estimate(bench, frames[some], place[some], prior, seek_place=False)
    good = np.isfinite(first.force).all(axis=1)
    if not good.any():
        return estimate(bench, frames, place, prior, seek_place=False)
    begin = np.column_stack([np.interp(np.arange(len(frames)), some[good], c) for c in first.force[good].T])
    return estimate(bench, frames, place, prior, seek_place=False, force=begin)


def _at_unknown_place(bench: Bench, frames: IntArray, prior: float) -> tuple[Estimates, Array]:
    """From the place of a scan that explains a frame best; and (F,) another that does about as well, NaN: none."""
    exact = replace(bench, place_sd=0.0)
    scan = [estimate(exact, frames, np.full(len(frames), s), prior, seek_place=False, restarts=0) for s in _SCAN]
    objective = np.stack([one.objective for one in scan])  # (places, F)
    best, every = np.argmin(objective, axis=0), np.arange(len(frames))
    force = np.nan_to_num(np.stack([one.force for one in scan])[best, every])
    found = estimate(bench, frames, _SCAN[best], prior, seek_place=True, force=force)
    padded = np.pad(objective, ((1, 1), (0, 0)), constant_values=np.inf)
    valley = (objective <= padded[:-2]) & (objective <= padded[2:])
    far = np.abs(_SCAN[:, None] - found.place) > np.maximum(_APART, 2.0 * np.sqrt(found.covariance[:, 2, 2]))
    rivals = np.where(valley & far, objective, np.inf)
    second = np.argmin(rivals, axis=0)
    as_well = rivals[second, every] < found.objective + _AS_WELL
    return found, np.where(as_well, _SCAN[second], np.nan)


def _sensed(
    bench: Bench, frames: IntArray, found: Estimates, other: Array, prior: float, settings: SenseSettings
) -> Sensed:
    o, covariance, sought = bench.observations, found.covariance[:, :2, :2], settings.place == "unknown"
    covariance = np.where(np.isfinite(found.force[:, :1, None]), covariance, np.nan)
    values, vectors = np.linalg.eigh(np.nan_to_num(covariance))
    known = np.isfinite(found.force[:, 0])
    distance = np.full(len(frames), np.nan)
    solved = np.linalg.solve(covariance[known], found.force[known][..., None])[..., 0]
    distance[known] = np.einsum("tc,tc->t", found.force[known], solved)
    touched: BoolArray = np.asarray(distance > _TOUCH)
    place_sd = np.sqrt(found.covariance[:, 2, 2]) if sought else np.full(len(frames), bench.place_sd / o.length)
    told = known & (place_sd < _PLACE_KNOWN) & np.isnan(other) if sought else known
    chosen = evenly_spread(np.flatnonzero(touched & known), _LOOKED_AT, len(frames)) if np.any(touched) else touched
    part = Estimates(*(values[chosen] for values in vars(found).values()))
    out = Sensed(
        name=o.source.name,
        settings=settings,
        prior_sd=prior,
        frame=o.frame[frames],
        time=o.time[frames],
        force=found.force,
        covariance=covariance,
        prior_share=np.stack([covariance[:, c, c] for c in range(2)], axis=1) / prior**2,
        place=np.where(told, found.place, np.nan),
        place_sd=np.where(known, place_sd, np.nan),
        other_place=np.where(known & touched, other, np.nan),
        weak_angle=np.where(known, np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]) % np.pi, np.nan),
        weak_sd=np.where(known, np.sqrt(values[:, 1]), np.nan),
        strong_sd=np.where(known, np.sqrt(values[:, 0]), np.nan),
        chi2=np.where(known, found.chi2, np.nan),
        touched=touched,
        contacts=_contacts(touched, o.time[frames]),
        misfit=misfit(bench, frames[chosen], part, sought_place=sought) if np.any(chosen) else None,
        logged=_logged(o, frames),
    )
    return replace(out, remarks=_remarks(out, bench))


def _logged(o: Observations, frames: IntArray) -> Array:
    if o.source.clean_force is None and not np.any(o.force):
        return np.full((len(frames), 2), np.nan)
    return o.force[frames]


def _contacts(touched: BoolArray, time: Array) -> tuple[Touch, ...]:
    """Stretches of at least `_RUN` frames in a row that show a force."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], touched, [False]]).astype(int)))
    runs = zip(edges[::2], edges[1::2], strict=True)
    return tuple(Touch(float(time[a]), float(time[b - 1])) for a, b in runs if b - a >= _RUN)


def _remarks(sensed: Sensed, bench: Bench) -> tuple[Remark, ...]:
    out, fit, lost = [], sensed.misfit, int(np.sum(np.isnan(sensed.force[:, 0])))
    if fit is not None and fit.ratio > _TOO_FAR and fit.probability < _UNLIKELY:
        text = (
            f"No force explains the shapes: the tags are {math.sqrt(fit.ratio):.2g} times as far off as k(s)'s band, "
            "mounting and noise allow, so the forces are not to be trusted. Check that the model is of this beam, that "
            "it stands in its clamp as it did then, where the force acts, and that the push is slow"
        )
        out.append(Remark("warning", text, about="sensed misfit"))
    if bench.stiffness is None:
        out.append(Remark("note", "The model has no band on k(s): the regions hold noise and mounting alone."))
    if not np.isfinite(bench.observations.rest_xy).any():
        out.append(Remark("note", "No frame shows the beam at rest: the mounting is known only as stated."))
    if not bench.observations.sd_known:
        out.append(Remark("note", "The tags' noise is a guess, and the regions are as good as it is."))
    if lost:
        out.append(Remark("note", f"In {lost} frames no equilibrium was found that explains the tags."))
    if np.any(sensed.touched):
        share = np.nanmedian(sensed.prior_share[sensed.touched], axis=0)
        weak = [f"{name} ({100 * one:.0f} %)" for name, one in zip("xy", share, strict=True) if one > _FROM_PRIOR]
        if weak:
            text = (
                f"The force along {' and '.join(weak)} comes in good part from the prior (sd {sensed.prior_sd:.3g} N)."
            )
            out.append(Remark("note", text))
    return tuple(out)
