"""The beam as a force sensor: the force on a beam whose k(s) is known, from its shape, frame by frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.blas import one_blas_thread
from onebend.errors import LearningError
from onebend.learning.design.instruments import Instruments
from onebend.learning.endings.let_go import ended
from onebend.learning.endings.mode import bending
from onebend.learning.model.force_error import force_error
from onebend.learning.sensing.bench import Bench, check_recording
from onebend.learning.sensing.edges import edges_of, frames_at_edges, runs_of, within
from onebend.learning.sensing.estimate import PLACE_PRIOR
from onebend.learning.sensing.frame_forces import read
from onebend.learning.sensing.joint import rested
from onebend.learning.sensing.prior import shared_prior
from onebend.learning.sensing.search import Searched, search, touches
from onebend.learning.sensing.sensed import (
    SecondForce,
    Sensed,
    SenseSettings,
    ToldMoment,
    Touch,
    check_settings,
    joined,
    logged_forces,
    sensed_remarks,
)
from onebend.learning.sensing.sensor import FEWEST, SensorCheck, ToldForces, check_sensor
from onebend.learning.sensing.smooth import Smoothed, smoothed
from onebend.learning.sensing.two import APART, STRIDE, Benches, TwoContacts, both_touch, two_said, two_sought
from onebend.records import Array, BoolArray, IntArray, Observations

PRIOR_SHARE = 3.0  # of k/L: the prior's sd of each component of the force
_NOTHING = 1e-4  # of the prior's sd: a force that is none
_PLACE_KNOWN = 0.1  # sd of s beyond which the place of the contact is not told
_PRIORS = (1e-9, 1e9)  # of the usual sd of a force: beyond, it is none of a beam


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
    bench, priors = bench_of(beam, o, stiffness, instruments, settings), priors_of(beam, settings)
    tells: BoolArray = np.sum(np.isfinite(o.xy), axis=(1, 2)) >= 2
    frames = np.flatnonzero(tells).astype(np.int64)
    if not frames.size:
        raise LearningError(f"{o.source.name}: no frame shows a tag of the beam, so no force can be told")
    place = places_of(o, frames, settings) if settings.place == "known" else None

    def benches(place_sds: tuple[float, ...]) -> Bench:
        return bench_of(beam, o, stiffness, instruments, settings, place_sds)

    try:
        return _told(benches, bench, frames, place, priors, settings)
    except np.linalg.LinAlgError as error:
        raise LearningError(
            f"{o.source.name}: the equations of the force cannot be solved ({error}). Check that the model is of this "
            "beam and as `onebend learn` wrote it"
        ) from error


def _told(
    benches: Benches, bench: Bench, frames: IntArray, place: Array | None, priors: Array, settings: SenseSettings
) -> Sensed:
    """By one force, or by two where they are asked for or the evidence is for them."""
    two = None
    if settings.contacts != "1":
        prior = float(priors[0])
        two, sds = _compared(benches, frames, place, prior, settings)
        if settings.contacts == "2" or two.found:
            bench, place = benches(sds), np.tile(two.places, (len(frames), 1))
            priors = np.full(4, prior)
    return _sensed(search(bench, frames, place, priors), frames, priors, settings, two)


def _compared(
    benches: Benches, frames: IntArray, place: Array | None, prior: float, settings: SenseSettings
) -> tuple[TwoContacts, tuple[float, float]]:
    """One contact against two, and what is known of the places of two before the frames [m]."""
    o = benches((0.0,)).observations
    if place is None:
        two = two_sought(benches, frames, prior)
        near, far = (o.length * min(max(STRIDE, 3.0 * sd), PLACE_PRIOR[1]) for sd in two.place_sds)
        return two, (near, far)
    assert settings.second_s is not None
    place_sd = o.stated.place_sd if settings.at_sd is None else settings.at_sd
    said = np.array([float(np.median(place)), settings.second_s])
    if abs(said[1] - said[0]) < APART:
        raise LearningError(
            f"{o.source.name}: two contacts at s = {said[0]:.3g} and {said[1]:.3g} are nearer to each other than "
            f"{APART:g}: no shape tells them apart. Ask for one"
        )
    return two_said(benches, frames, said, (place_sd, place_sd), prior), (place_sd, place_sd)


def priors_of(beam: Beam, settings: SenseSettings) -> Array:
    """(n,) N, N, and N m where a moment is asked for: one sd of each before any shape is seen."""
    force = prior_of(beam, settings)
    moment = force * beam.length if settings.moment_prior is None else settings.moment_prior
    return np.array([force, force, moment][: 3 if settings.moment else 2])


def prior_of(beam: Beam, settings: SenseSettings) -> float:
    """N, one sd of each component of the force before any shape is seen.

    Raises:
        LearningError: what is asked for is beyond any force on this beam.
    """
    mean_k = float(np.mean(np.asarray(beam.stiffness(np.linspace(0.0, 1.0, 101)))))
    usual, given = PRIOR_SHARE * mean_k / beam.length, settings.force_prior
    if given is not None and not _PRIORS[0] < given / usual < _PRIORS[1]:
        raise LearningError(f"a force prior of {given:g} N is beyond any force on this beam; usual is {usual:.3g} N")
    return usual if given is None else given


def bench_of(
    beam: Beam,
    o: Observations,
    stiffness: UncertainStiffness | None,
    instruments: Instruments | None,
    settings: SenseSettings,
    place_sds: tuple[float, ...] | None = None,
) -> Bench:
    """The bench as the beam at rest leaves it; `place_sds`: m, of the place of each contact, None: as the settings and
    the recording have it for one.

    Raises:
        LearningError: as `sense`.
    """
    check_settings(settings, o.source.name, o.length)
    check_recording(beam, o)
    place_sd = o.stated.place_sd if settings.at_sd is None else settings.at_sd
    sds = place_sds if place_sds is not None else (0.0 if settings.place == "unknown" else place_sd,)
    as_learned = settings.tags == "learned"
    prior = shared_prior(o, stiffness, instruments, tags_as_learned=as_learned, place_sd=sds)
    return rested(Bench(beam, stiffness, prior, o, prior.mean, prior.root))


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


def _sensed(
    searched: Searched, frames: IntArray, priors: Array, settings: SenseSettings, two: TwoContacts | None
) -> Sensed:
    bench, found, other, prior = searched.bench, searched.found, searched.other_place, float(priors[0])
    n = len(priors)
    o, axes = bench.observations, bench.axes_of_loads(n)
    load, covariance = found.force @ axes.T, axes @ found.covariance[:, :n, :n] @ axes.T
    known: BoolArray = np.asarray(np.isfinite(found.force[:, 0]))
    covariance = np.where(known[:, None, None], covariance, np.nan)
    values, vectors = np.linalg.eigh(np.nan_to_num(covariance[:, :2, :2]))
    touched = touches(found)
    contacts, smooth = _over_time(searched, frames, touched, priors, settings)
    place, place_sd = _places(searched, n, settings, two, known)
    share = np.einsum("tcc->tc", covariance) / priors**2
    out = Sensed(
        name=o.source.name,
        settings=settings,
        prior_sd=prior,
        frame=o.frame[frames],
        time=o.time[frames],
        force=load[:, :2],
        covariance=covariance[:, :2, :2],
        prior_share=share[:, :2],
        place=place,
        place_sd=place_sd,
        other_place=np.where(known & touched, other, np.nan),
        weak_angle=np.where(known, np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]) % np.pi, np.nan),
        weak_sd=np.where(known, np.sqrt(values[:, 1]), np.nan),
        strong_sd=np.where(known, np.sqrt(values[:, 0]), np.nan),
        chi2=np.where(known, found.chi2, np.nan),
        touched=touched,
        contacts=contacts,
        misfit=searched.misfit,
        logged=logged_forces(o)[frames],
        common=(axes @ found.common)[:, :2],
        smoothed=None if smooth is None else smooth.turned(bench.axes),
        two=two,
    )
    if n == 3:
        moment = ToldMoment(
            load[:, 2], np.sqrt(covariance[:, 2, 2]), covariance[:, :2, 2], float(priors[2]), share[:, 2]
        )
        out = replace(out, moment=moment)
    if n == 4:
        out = replace(out, second=_second(load, covariance, share, searched, two))
    out = replace(out, sensor=None if n > 3 or not out.explained else _judged(out, o, frames))
    return replace(out, remarks=sensed_remarks(out, o, banded=bench.stiffness is not None))


def _places(
    searched: Searched, n: int, settings: SenseSettings, two: TwoContacts | None, known: BoolArray
) -> tuple[Array, Array]:
    """(T,) s of the first force and one sd each; NaN where it was sought and not found."""
    bench, found = searched.bench, searched.found
    sought = settings.place == "unknown"
    if sought and n != 4:
        place_sd = np.sqrt(found.covariance[:, -1, -1])
        told = known & (place_sd < _PLACE_KNOWN) & np.isnan(searched.other_place)
        return np.where(told, found.place, np.nan), np.where(known, place_sd, np.nan)
    place_sd = np.full(len(known), bench.place_sd / bench.observations.length)
    place = bench.placed(found.place).reshape(len(known), -1)[:, 0]
    told = known & (not sought or (two is not None and not two.others)) & (place_sd < _PLACE_KNOWN)
    return np.where(told, place, np.nan), np.where(known, place_sd, np.nan)


def _second(load: Array, covariance: Array, share: Array, searched: Searched, two: TwoContacts | None) -> SecondForce:
    bench = searched.bench
    place_sd = float(np.linalg.norm(bench.root[bench.parts["place"]][1])) / bench.observations.length
    told = place_sd < _PLACE_KNOWN and not (two is not None and two.others)
    place = float(np.nanmedian(bench.placed(searched.found.place)[:, 1]))
    return SecondForce(
        force=load[:, 2:],
        covariance=covariance[:, 2:, 2:],
        with_first=covariance[:, :2, 2:],
        prior_share=share[:, 2:],
        place=place if told else math.nan,
        place_sd=place_sd,
        touched=both_touch(searched.found)[1],
    )


def _judged(out: Sensed, o: Observations, frames: IntArray) -> SensorCheck | None:
    """The log by the force; where nothing touches the beam, that is none, in every direction."""
    if np.sum(np.isfinite(out.logged).all(axis=1)) < FEWEST:
        return None
    bare = ~(o.loaded[frames] | out.touched) & np.isfinite(out.force).all(axis=1)
    force, covariance = np.where(bare[:, None], 0.0, out.force), out.covariance.copy()
    covariance[bare] = (_NOTHING * out.prior_sd) ** 2 * np.eye(2)
    common = np.where(bare[:, None, None], 0.0, out.common)
    told = ToldForces(out.time, force, covariance, common, out.prior_sd)
    clock_sd = 0.0 if o.source.clock is None else o.source.clock.sd
    return check_sensor(told, out.logged, force_error(o, out.time), o.source.clean_force, clock_sd)


def _over_time(
    searched: Searched, frames: IntArray, touched: BoolArray, priors: Array, settings: SenseSettings
) -> tuple[tuple[Touch, ...], Smoothed | None]:
    """When each contact began and ended, and the force as a process where that is asked for."""
    runs, time, prior = runs_of(touched), searched.bench.observations.time[frames], float(priors[0])
    some = np.arange(len(frames)) if settings.smooth else frames_at_edges(runs, len(frames))
    if not runs:
        return (), smoothed(time, searched.found, [], prior, 1.0) if settings.smooth else None
    found, inside = searched.found.take(some), within(runs, len(frames))[some]
    force = np.where(inside[:, None] | np.isnan(found.force), found.force, 0.0)
    seek_place = settings.place == "unknown" and len(priors) < 4
    readings = read(searched.bench, frames[some], force, found.place, priors, seek_place=seek_place)
    bench = searched.bench
    every = ended(bending(bench.beam, bench.observations).take(frames), runs, readings.widened)
    both = zip(every, edges_of(readings, some, every, len(frames), prior), strict=True)
    contacts = joined([Touch(float(time[c.first]), float(time[c.last]), begin, end) for c, (begin, end) in both])
    if not settings.smooth:
        return contacts, None
    spans = [np.searchsorted(time, one.span) for one in contacts]
    runs = [(int(a), int(b) - 1) for a, b in spans if b > a]
    return contacts, smoothed(time, searched.found, runs, prior, readings.widened)
