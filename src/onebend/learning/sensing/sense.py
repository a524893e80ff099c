"""The beam as a force sensor: the force on a beam whose k(s) is known, from its shape, frame by frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.beam.statics.rod import has_mass
from onebend.blas import one_blas_thread
from onebend.errors import LearningError
from onebend.learning.design.instruments import Instruments
from onebend.learning.model.mass import NEEDS_MASS, weighs
from onebend.learning.sensing.bench import Bench
from onebend.learning.sensing.edges import edges_of, frames_at_edges, runs_of, within
from onebend.learning.sensing.joint import rested
from onebend.learning.sensing.prior import shared_prior
from onebend.learning.sensing.readings import read
from onebend.learning.sensing.search import Searched, search, touches
from onebend.learning.sensing.sensed import Sensed, SenseSettings, Touch
from onebend.learning.sensing.sensor import SensorCheck, check_sensor
from onebend.learning.sensing.smooth import Smoothed, smoothed
from onebend.records import Array, BoolArray, IntArray, Observations, Remark

PRIOR_SHARE = 3.0  # of k/L: the prior's sd of each component of the force
_NOTHING = 1e-4  # of the prior's sd: a force that is none
_PLACE_KNOWN = 0.1  # sd of s beyond which the place of the contact is not told
_TOO_FAR, _UNLIKELY = 2.5, 1e-4  # of the misfit: its ratio and probability from which it is a warning
_FROM_PRIOR = 0.25  # share of a component's variance left by the data from which it is said


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
    bench, prior = bench_of(beam, o, stiffness, instruments, settings), prior_of(beam, settings)
    tells: BoolArray = np.sum(np.isfinite(o.xy), axis=(1, 2)) >= 2
    frames = np.flatnonzero(tells).astype(np.int64)
    if not frames.size:
        raise LearningError(f"{o.source.name}: no frame shows a tag of the beam, so no force can be told")
    place = places_of(o, frames, settings) if settings.place == "known" else None
    return _sensed(search(bench, frames, place, prior), frames, prior, settings)


def prior_of(beam: Beam, settings: SenseSettings) -> float:
    """N, one sd of each component of the force before any shape is seen."""
    mean_k = float(np.mean(np.asarray(beam.stiffness(np.linspace(0.0, 1.0, 101)))))
    return PRIOR_SHARE * mean_k / beam.length if settings.force_prior is None else settings.force_prior


def bench_of(
    beam: Beam,
    o: Observations,
    stiffness: UncertainStiffness | None,
    instruments: Instruments | None,
    settings: SenseSettings,
) -> Bench:
    """The bench as the beam at rest leaves it.

    Raises:
        LearningError: as `sense`.
    """
    _check(beam, o, settings)
    place_sd = o.stated.place_sd if settings.at_sd is None else settings.at_sd
    sought = settings.place == "unknown"
    as_learned = settings.tags == "learned"
    prior = shared_prior(o, stiffness, instruments, tags_as_learned=as_learned, place_sd=0.0 if sought else place_sd)
    return rested(Bench(beam, stiffness, prior, o, prior.mean, prior.root))


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


def places_of(o: Observations, frames: IntArray, settings: SenseSettings) -> Array:
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


def _sensed(searched: Searched, frames: IntArray, prior: float, settings: SenseSettings) -> Sensed:
    bench, found, other = searched.bench, searched.found, searched.other_place
    o, sought, axes = bench.observations, settings.place == "unknown", bench.axes
    force, covariance = found.force @ axes.T, axes @ found.covariance[:, :2, :2] @ axes.T
    covariance = np.where(np.isfinite(found.force[:, :1, None]), covariance, np.nan)
    values, vectors = np.linalg.eigh(np.nan_to_num(covariance))
    known = np.isfinite(found.force[:, 0])
    touched = touches(found)
    contacts, smooth = _over_time(searched, frames, touched, prior, settings)
    place_sd = np.sqrt(found.covariance[:, 2, 2]) if sought else np.full(len(frames), bench.place_sd / o.length)
    told = known & (place_sd < _PLACE_KNOWN) & np.isnan(other) if sought else known
    place = found.place if sought else bench.placed(found.place)
    out = Sensed(
        name=o.source.name,
        settings=settings,
        prior_sd=prior,
        frame=o.frame[frames],
        time=o.time[frames],
        force=force,
        covariance=covariance,
        prior_share=np.stack([covariance[:, c, c] for c in range(2)], axis=1) / prior**2,
        place=np.where(told, place, np.nan),
        place_sd=np.where(known, place_sd, np.nan),
        other_place=np.where(known & touched, other, np.nan),
        weak_angle=np.where(known, np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]) % np.pi, np.nan),
        weak_sd=np.where(known, np.sqrt(values[:, 1]), np.nan),
        strong_sd=np.where(known, np.sqrt(values[:, 0]), np.nan),
        chi2=np.where(known, found.chi2, np.nan),
        touched=touched,
        contacts=contacts,
        misfit=searched.misfit,
        logged=_logged(o, frames),
        common=axes @ found.common,
        smoothed=None if smooth is None else smooth.turned(axes),
    )
    sensor = None if _unexplained(out) else _judged(out, o, frames)
    return replace(out, sensor=sensor, remarks=_remarks(out, bench))


def _unexplained(out: Sensed) -> bool:
    """Whether no force explains the shapes."""
    return out.misfit is not None and out.misfit.ratio > _TOO_FAR and out.misfit.probability < _UNLIKELY


def _judged(out: Sensed, o: Observations, frames: IntArray) -> SensorCheck | None:
    """The log by the force; where nothing touches the beam, that is none, in every direction."""
    bare = ~(o.loaded[frames] | out.touched) & np.isfinite(out.force).all(axis=1)
    force, covariance = np.where(bare[:, None], 0.0, out.force), out.covariance.copy()
    covariance[bare] = (_NOTHING * out.prior_sd) ** 2 * np.eye(2)
    common = np.where(bare[:, None, None], 0.0, out.common)
    return check_sensor(out.time, force, covariance, common, out.logged, o.source.clean_force)


def _logged(o: Observations, frames: IntArray) -> Array:
    if o.source.clean_force is None and not np.any(o.force):
        return np.full((len(frames), 2), np.nan)
    return o.force[frames]


def _over_time(
    searched: Searched, frames: IntArray, touched: BoolArray, prior: float, settings: SenseSettings
) -> tuple[tuple[Touch, ...], Smoothed | None]:
    """When each contact began and ended, and the force as a process where that is asked for."""
    runs, time = runs_of(touched), searched.bench.observations.time[frames]
    some, sought, shown = frames_at_edges(runs, len(frames)), settings.place == "unknown", searched.bench
    found, inside = searched.found.take(some), within(runs, len(frames))[some]
    contacts: tuple[Touch, ...] = ()
    if runs:
        force = np.where(inside[:, None] | np.isnan(found.force), found.force, 0.0)
        readings = read(shown, frames[some], force, found.place, prior, seek_place=sought)
        both = zip(runs, edges_of(readings, some, runs, len(frames), prior), strict=True)
        contacts = tuple(Touch(float(time[a]), float(time[b]), begin, end) for (a, b), (begin, end) in both)
    if not settings.smooth:
        return contacts, None
    spans = [(*np.searchsorted(time, one.span),) for one in contacts]
    inside = within([(int(a), int(b) - 1) for a, b in spans], len(frames))
    return contacts, smoothed(shown, frames, searched.found, inside, prior, seek_place=sought)


def _remarks(sensed: Sensed, bench: Bench) -> tuple[Remark, ...]:
    out, fit, lost = [], sensed.misfit, int(np.sum(np.isnan(sensed.force[:, 0])))
    if fit is not None and _unexplained(sensed):
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
