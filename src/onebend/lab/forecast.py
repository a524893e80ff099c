"""Expected accuracy of k(s), from the Fisher information and the fit's prior.

Let I be the data's information on the coefficients c of log k, all nuisances marginalised. Noise-free data give
`-2 log p = x' I x - 2 x' I c` for the coefficients x. The fit's posterior of log k (`stiffness_mixture`) under these
data gives the band, its covariance C, and the bias, its mean minus c. Noise of covariance I on `I c` moves the mean by
C times the noise, so the scatter between recordings is `C I C`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from math import isfinite, isnan, nan
from pathlib import Path

import numpy as np
from scipy.linalg import solve_triangular

from onebend.beam.model import Beam
from onebend.beam.stiffness import IDENTIFIED_SD
from onebend.errors import MechanicsError, RecordingError
from onebend.lab.bench import FRANKA, WRIST, ForceSensor, PushProfile, TagNoise
from onebend.lab.designs import find_design
from onebend.lab.random_bench import SENSORS, SWINGING, FilmRequest, SensorName, camera_of, push_of
from onebend.lab.rendering import Camera, check_name, view_from
from onebend.lab.virtual import LOG_BEFORE, VirtualBench, VirtualTag, tag_poses
from onebend.learning import design as planning, normal, optimizer, parameters
from onebend.learning.instruments import ForceDoubt, Instruments, PlannedPush
from onebend.options import NOT_NEGATIVE, option
from onebend.progress import Progress, Silent, one_blas_thread, track
from onebend.recording.beam_frame import MOUNTING_SD
from onebend.recording.plane import project
from onebend.recording.signals import runs
from onebend.records import CLAMP_SD, CURVATURE_SD, DIRECTION_SD, PLACE_SD, TURN_SD, Array, BoolArray, Rest
from onebend.report.sentences import direction_words
from onebend.results.model import FILE_NAME, read_model

THIRDS = (1.0 / 3.0, 2.0 / 3.0, 1.0)
CORNER_SD = 0.1  # px, of a tag's corner; the centre is known to half of it
TAG_SHARE = 0.08  # a tag's side over the length
NEAREST_TAGS = 0.02  # in s: closer tags would overlap
LEAST_TURN_DEG, MOST_TURN_DEG = 3.0, 150.0  # at the place of the push
FEWEST_FRAMES = 20  # per push


@dataclass(frozen=True)
class Tolerances:
    """One sd each."""

    gain_sd: float = option("--gain-sd", nan, metavar="SD", within=(0.0, 0.5))
    placement_sd: float = option("--placement-mm", 5e-4, within=(1e-3, 1e9))
    turn_sd: float = option("--turn-deg", TURN_SD, within=(1e-3, 1e9))
    clock_sd: float = option("--clock-sd-s", nan, within=NOT_NEGATIVE)


@dataclass(frozen=True)
class Setup:
    """One or more pushes of a known beam. Errors are one sd."""

    name: str
    beam: Beam
    pushes: tuple[PushProfile, ...]
    tags: tuple[float, ...] = THIRDS
    sensor: ForceSensor = FRANKA
    noise: TagNoise = field(default_factory=TagNoise)
    fps: float = 30.0
    placement_sd: float = Tolerances.placement_sd  # m, along and across
    turn_sd: float = Tolerances.turn_sd  # rad
    clock_sd: float = nan  # s; 0: one clock; NaN: found from the data

    def __post_init__(self) -> None:
        check(self)

    @property
    def gain_sd(self) -> float:
        """Of the force's scale, as declared."""
        return self.sensor.gain_sd

    @property
    def rest(self) -> Rest:
        s = np.linspace(0.0, 1.0, 101)
        return "unknown" if np.any(np.asarray(self.beam.rest_curvature(s)) != 0.0) else "straight"


def check(setup: Setup) -> None:
    """Raises `RecordingError`: an impossible setup, with the remedy."""
    _check_tags(setup.tags)
    if not setup.pushes:
        raise RecordingError("a rehearsal needs at least one push")
    for push in setup.pushes:
        _check_push(setup, push)
    for what, size in (("placement_sd", setup.placement_sd), ("turn_sd", setup.turn_sd)):
        if not (isfinite(size) and size > 0.0):
            raise RecordingError(f"{what} must be above zero, got {size}: no tag is put on without an error")
    if not setup.fps > 0.0 or setup.clock_sd < 0.0:
        raise RecordingError("the frame rate must be above zero, and the clock's sd, where it is given, not below")


def _check_tags(tags: tuple[float, ...]) -> None:
    if not tags:
        raise RecordingError("a rehearsal needs at least one tag on the beam. Give --tags, such as 0.33,0.67,1")
    for s in tags:
        if not 0.0 < s <= 1.0:
            where = "beyond the tip (s = 1)" if s > 1.0 else "not on the beam: s = 0 is the clamp"
            raise RecordingError(f"a tag at s = {s:g} is {where}. Give places in (0, 1]")
    for place, other in zip(sorted(tags), sorted(tags)[1:], strict=False):
        if other - place < NEAREST_TAGS:
            raise RecordingError(f"tags at s = {place:g} and {other:g} would overlap. Keep them {NEAREST_TAGS:g} apart")


def _check_push(setup: Setup, push: PushProfile) -> None:
    first = min(setup.tags)
    if push.at_s < first - 1e-6:
        raise RecordingError(
            f"a push at s = {push.at_s:g} is before the first tag (s = {first:.3g}): nothing would be seen between "
            "clamp and push. Push farther out, or put a tag nearer to the clamp"
        )
    if not (isfinite(push.peak) and push.peak > 0.0):
        raise RecordingError(f"a push needs a force above zero, got {push.peak} N")
    seconds = push.contact[1] - push.contact[0]
    if seconds * setup.fps < FEWEST_FRAMES:
        raise RecordingError(
            f"a push of {seconds:.3g} s at {setup.fps:g} frames/s gives {seconds * setup.fps:.0f} frames; at least "
            f"{FEWEST_FRAMES} are needed. Push for longer"
        )
    if push.before < 0.5:
        raise RecordingError("a push needs half a second of rest before it, which shows the beam and the log at rest")


@dataclass(frozen=True)
class KnownBeam:
    """A known beam, with its tags' places if it was learned from tags."""

    name: str
    beam: Beam
    tags: tuple[float, ...] = THIRDS


def known_beam(name_or_path: str) -> KnownBeam:
    """A named design, a design's TOML, or a learned beam (model.json or its folder). Raises `MechanicsError`,
    `ResultsError`: missing or unreadable."""
    path = Path(name_or_path)
    if path.suffix == ".json" or (path.is_dir() and (path / FILE_NAME).is_file()):
        stored = read_model(path)
        k = np.asarray(stored.beam.stiffness(np.linspace(0.0, 1.0, 201)))
        if not np.all(k > 0.0):
            raise MechanicsError(f"{path}: k(s) is not positive everywhere, so this beam cannot be rehearsed")
        tags = stored.bench.tags if stored.bench is not None else stored.origin.marker_s if stored.origin else THIRDS
        return KnownBeam(path.resolve().parent.name if path.suffix else path.resolve().name, stored.beam, tuple(tags))
    design = find_design(name_or_path)
    return KnownBeam(design.name, design.beam())


@one_blas_thread
def setup_of(
    known: KnownBeam,
    requests: Sequence[FilmRequest],
    *,
    tags: Sequence[float] = (),
    known_to: Tolerances = Tolerances(),
) -> Setup:
    """The requested setup; camera, frame rate and sensor are those of the first request. Raises `RecordingError`: an
    invalid number, or a push that makes the beam swing. Raises `MechanicsError`: snap-through."""
    first = requests[0]
    for request in requests:
        if request.push in SWINGING:
            raise RecordingError(
                f"a {request.push} push makes the beam swing, and is not learned from. Take a slow one"
            )
    camera, fps = camera_of(first)
    sensor = SENSORS[check_name(first.sensor, SensorName, "sensor")][0]
    sensor = sensor if isnan(known_to.gain_sd) else replace(sensor, gain_sd=known_to.gain_sd)
    places = tuple(sorted(float(s) for s in tags)) or known.tags
    pushes = tuple(push_of(request, known.beam) for request in requests)
    sds = known_to.placement_sd, known_to.turn_sd, known_to.clock_sd
    setup = Setup(known.name, known.beam, pushes, places, sensor, TagNoise(), fps, *sds)
    for push in pushes:
        if push.peak < 1e-9:
            raise MechanicsError(f"the beam buckles under any push at s = {push.at_s:g} in this direction")
    return replace(setup, noise=tag_noise(camera, setup))


def check_bending(setup: Setup) -> None:
    """Raises `MechanicsError`: a push bends the beam too little, or more than a tool can follow."""
    rest = VirtualBench(setup.beam, setup.pushes[0], tags=(VirtualTag(0, 1.0),))
    for push in setup.pushes:
        bench = replace(rest, push=push, tags=(VirtualTag(0, push.at_s),))
        angle = tag_poses(bench, push.force(np.linspace(*push.contact, 25)))[:, 0, 2]
        turn = float(np.rad2deg(np.max(np.abs(angle - angle[0]))))
        what = f"{push.peak:.3g} N at s = {push.at_s:g} would turn the beam there by"
        if turn < LEAST_TURN_DEG:
            raise MechanicsError(
                f"{what} only {turn:.2g} deg, from which nothing is learned. Push harder, or across the beam"
            )
        if turn > MOST_TURN_DEG:
            raise MechanicsError(f"{what} {turn:.0f} deg, which no tool can follow. Give a smaller force")


def tag_noise(camera: Camera, setup: Setup) -> TagNoise:
    """Noise of tag poses for a camera that shows the whole push: `CORNER_SD` in its pixels.

    A square's centre is known to half a corner's sd, its angle to that sd over the diagonal. Raises `MechanicsError`:
    snap-through.
    """
    edge = 0.75 * TAG_SHARE * setup.beam.length  # middle of a tag to the edge of its paper
    places = [np.zeros((1, 2))]
    for push in setup.pushes:
        bench = VirtualBench(setup.beam, push, tags=tuple(VirtualTag(i, s) for i, s in enumerate(setup.tags)))
        poses = tag_poses(bench, push.force(np.linspace(*push.contact, 25)))
        places.append(poses[..., :2].reshape(-1, 2))
    corners = edge * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    view = view_from(camera, (np.concatenate(places)[:, None] + corners).reshape(-1, 2))
    middle = np.mean(np.concatenate(places), axis=0)
    step = 1e-3 * setup.beam.length
    px = project(view, middle + step * np.array([[-1.0, 0.0], [1.0, 0.0]]))
    size = 2.0 * step / float(np.hypot(*(px[1] - px[0])))  # m per px
    diagonal = np.sqrt(2.0) * TAG_SHARE * setup.beam.length / size
    return TagNoise(white_xy=0.5 * CORNER_SD * size, white_angle=CORNER_SD / float(diagonal))


# Instruments before the first push, as the fit describes them. The force's noise is the sensor's, in the parts that the
# fit models. Every push has its own errors of place, of force axes, and of force at onset and reversal. A clock offset
# found from the data has an sd by a rule of thumb, good to a factor of two for pushes of 4 to 13 s: a share of the
# push's duration, proportional to the relative force error plus 3 % for the misfit of a linear relation (docs/plan.md).

FUNCTIONS = optimizer.FitSettings.functions  # of log k
MOST_FRAMES = 200  # per push, for prediction and fit
_CUTOFF_CYCLES = 11.0  # over the seconds of contact, Hz: the usual choice for a smooth push
_LEAST_WALK = 1.5e-3  # of the peak, N / sqrt(s): the fit assumes no better log
# Share of the sensor's reversal error that acts as a constant over the push. That error is redrawn at onset and
# reversal; the difference between both halves is visible, since one force gives one shape.
_REVERSAL_SHARE = 0.75
_CLOCK_SHARE, _RELATION_MISFIT = 0.28, 0.03  # of the push's time; of the peak


def even_push(push: PushProfile) -> PlannedPush:
    """The same push growing evenly from zero, in its middle direction."""
    return PlannedPush(push.at_s, push.direction, push.peak)


def instruments(setup: Setup) -> Instruments:
    """Before any push; if pushes differ, those of the longest."""
    push = max(setup.pushes, key=_seconds)
    seconds, tags = _seconds(push), len(setup.tags)
    shared = ("along", "across", "turn") if setup.rest == "straight" else ("curvature", "along", "across", "turn")
    sd = {"curvature": [CURVATURE_SD] * 3, "turn": [setup.turn_sd] * tags}
    prior = np.concatenate([sd.get(name, [setup.placement_sd] * tags) for name in shared])
    clock = clock_sd(setup.sensor, push) if math.isnan(setup.clock_sd) else setup.clock_sd
    return Instruments(
        length=setup.beam.length,
        tags=setup.tags,
        tag_sd=np.tile([setup.noise.white_xy, setup.noise.white_xy, setup.noise.white_angle], (tags, 1)),
        frames=min(round(seconds * setup.fps), MOST_FRAMES),
        seconds=seconds,
        rest_before=push.before + LOG_BEFORE,
        rest_after=push.after + LOG_BEFORE if push.after > 0.0 else 0.0,
        placement_sd=setup.placement_sd,
        turn_sd=setup.turn_sd,
        curvature_sd=0.0 if setup.rest == "straight" else CURVATURE_SD,
        clamp_sd=clamp_sd(setup, CLAMP_SD),
        origin_sd=setup.placement_sd,
        clock_sd=clock,
        force=force_doubt(setup.sensor, push),
        gain_sd=setup.gain_sd,
        curvature=1.0,
        shared=shared,
        shared_slope=np.zeros((len(prior), FUNCTIONS)),
        shared_covariance=np.diag(prior**2),
        place_sd=PLACE_SD,
        direction_sd=DIRECTION_SD,
    )


def clamp_sd(setup: Setup, own: float) -> float:
    """rad, as in `learning.parameters.clamp_sd`, with all tags seen at rest."""
    if setup.rest == "unknown":
        return float(np.hypot(own, MOUNTING_SD))
    reach = setup.beam.length * float(np.linalg.norm(setup.tags))
    return float(np.hypot(own, 2.0 * setup.placement_sd / reach))


def force_doubt(sensor: ForceSensor, push: PushProfile) -> ForceDoubt:
    """A sensor's errors after the low-pass filter."""
    seconds = _seconds(push)
    cutoff = _CUTOFF_CYCLES / seconds
    white = sensor.white_sd * np.sqrt(min(2.0 * cutoff / sensor.rate, 1.0))
    walk = np.hypot(sensor.drift, _LEAST_WALK * push.peak)
    coloured, tau = sensor.coloured_sd, sensor.coloured_time
    if coloured == 0.0:  # negligible process
        coloured, tau = 1e-4 * push.peak, 0.3
    return ForceDoubt(
        level=max(float(np.hypot(*sensor.bias)), push.peak),
        coloured=coloured,
        tau=tau,
        cutoff=cutoff,
        walk=float(walk),
        frame=float(white),
        load=_REVERSAL_SHARE * sensor.reversal,
    )


def clock_sd(sensor: ForceSensor, push: PushProfile) -> float:
    """s, expected sd of the clock search."""
    error = float(np.sqrt(2.0 * sensor.reversal**2 + sensor.drift**2 * _seconds(push) + sensor.coloured_sd**2))
    return _CLOCK_SHARE * 0.5 * _seconds(push) * float(np.hypot(error / push.peak, _RELATION_MISFIT))


def _seconds(push: PushProfile) -> float:
    begin, end = push.contact
    return end - begin


SPLINE = parameters.Spline(FUNCTIONS)
BASIS = SPLINE.basis(planning.PLACES)
_DRAWS = normal.Draws(chains=36, burn=150, kept=100)  # of the prior's sizes: the band's sd is good to about 3 %


@dataclass(frozen=True)
class PredictedBand:
    """Sizes of log k at the 101 `PLACES`; one sd, including the force's gain unless stated."""

    k: Array  # N m, truth
    sd: Array  # of the band
    own_sd: Array  # of the band without the gain's error
    scatter: Array  # of the estimate between recordings
    bias: Array  # of the estimate, from the prior
    prior: Array  # (p, p) precision of the equivalent normal prior
    quality: planning.Quality

    @property
    def identified(self) -> BoolArray:
        """Where the data rather than the prior set the band."""
        return np.asarray(self.own_sd < IDENTIFIED_SD)

    @property
    def error(self) -> Array:
        """RMS over recordings."""
        return np.asarray(np.hypot(self.scatter, self.bias))


@one_blas_thread
def predict(setup: Setup) -> PredictedBand:
    """The posterior for noise-free data. Raises `MechanicsError`: the beam buckles or snaps through."""
    information = information_of(setup, instruments(setup))
    k = np.asarray(setup.beam.stiffness(planning.PLACES))
    truth = np.linalg.lstsq(BASIS, np.log(k), rcond=None)[0]
    posterior = normal.stiffness_mixture(
        SPLINE, [normal.InformationForm(information, information @ truth)], float(np.mean(np.log(k))), _DRAWS
    )
    prior = equivalent_prior(posterior.covariance, information)
    bias = np.asarray(BASIS @ (posterior.mean - truth))
    return _band(k, bias, prior, information, setup.gain_sd)


def information_of(setup: Setup, bench: Instruments) -> Array:
    """(p, p) information of all pushes on the coefficients of log k; they share tags and rest shape."""
    pushes = [planning.tag_derivatives(setup.beam, bench, even_push(push), SPLINE.basis) for push in setup.pushes]
    joint = np.sum([planning.joint_information(one, bench) for one in pushes], axis=0)
    return planning.eliminate(joint, bench.shared_size, planning.alone(bench))


def equivalent_prior(covariance: Array, information: Array) -> Array:
    """(p, p) precision P of the normal prior with `(I + P)^-1 = covariance`.

    With covariance = L L', P = L^-T (1 - L' I L) L^-1. Where random draws make the covariance larger than the data
    allow, that part of P is zero.
    """
    root = np.linalg.cholesky(covariance)
    values, vectors = np.linalg.eigh(root.T @ information @ root)
    factor = solve_triangular(root, vectors * np.sqrt(np.maximum(1.0 - values, 0.0)), lower=True, trans="T")
    return np.asarray(factor @ factor.T)


def _band(k: Array, bias: Array, prior: Array, information: Array, gain_sd: float) -> PredictedBand:
    covariance = np.asarray(np.linalg.inv(information + prior))
    own_sd = _sd_along(covariance)
    sd = np.hypot(own_sd, gain_sd)
    scatter = np.hypot(_sd_along(np.asarray(covariance @ information @ covariance)), gain_sd)
    return PredictedBand(k, sd, own_sd, scatter, bias, prior, planning.quality_of(sd, own_sd))


def _sd_along(covariance: Array) -> Array:
    """(101,) sd of log k at `PLACES`."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("si,ij,sj->s", BASIS, covariance, BASIS), 0.0)))


def ranges(known: BoolArray) -> list[tuple[float, float]]:
    """Ranges of s where `known` (101,) holds."""
    return [(float(planning.PLACES[first]), float(planning.PLACES[end - 1])) for first, end in runs(known)]


AT_S = (0.5, 0.65, 0.8, 1.0)
DIRECTIONS_DEG = (70.0, 100.0, 130.0)
SIZES = (1.0, 0.6)  # of the largest force within the limits
LIMITS = planning.Limits()  # tip turn at most 90 deg; bending at most 1.25 times the planned one
BETTER = 5.0  # factor of improvement of a placement or sensor
GAIN_SD = 0.01  # after calibration with a weight
SYNCHRONISED = 0.005  # s
APART = 0.15  # in s: closer pushes count as one
LEAST_SHARE = 0.01  # smallest reduction worth advising
_SENSOR_SIZES = ("white_sd", "coloured_sd", "drift", "reversal", "gain_sd", "quantum")


@dataclass(frozen=True)
class SetupChange:
    """One change of the setup, and the resulting band."""

    kind: str  # tag, push, second push, gain, sensor, placement, clock, camera
    text: str
    setup: Setup
    quality: planning.Quality
    share: float  # reduction of the band's mean width; negative: growth

    def as_dict(self) -> dict[str, object]:
        pushes = [{"at_s": p.at_s, "direction_rad": p.direction, "peak_N": p.peak} for p in self.setup.pushes]
        done = {"tags_s": list(self.setup.tags), "pushes": pushes}
        return {"kind": self.kind, "text": self.text, "removes": self.share, "after": asdict(self.quality), **done}


@one_blas_thread
def advise(
    setup: Setup, now: PredictedBand, *, count: int = 8, progress: Progress = Silent()
) -> tuple[SetupChange, ...]:
    """The changes that narrow the band most, best first; at most two per kind. Raises `MechanicsError`: the setup's own
    push has no stable equilibrium."""
    if count < 1:
        return ()
    thoughts = [*_tags(setup), *_pushes(setup), *_instruments(setup)]
    changes = []
    for kind, text, changed in track(progress, "weighing changes", thoughts, len(thoughts)):
        try:
            information = information_of(changed, instruments(changed))
        except MechanicsError:
            continue  # stable at the sampled sizes, but not between them
        quality = _band(now.k, now.bias, now.prior, information, changed.gain_sd).quality
        changes.append(SetupChange(kind, text, changed, quality, 1.0 - quality.mean_width / now.quality.mean_width))
    return _distinct(sorted(changes, key=lambda change: -change.share))[:count]


Candidate = tuple[str, str, Setup]


def _tags(setup: Setup) -> Iterator[Candidate]:
    places = planning.gaps(setup.tags)
    for s in places.tolist():
        yield "tag", f"one more tag at s = {s:.2f}", replace(setup, tags=tuple(sorted((*setup.tags, round(s, 3)))))
    places = places[places < 1.0]
    if len(places) > 1:
        more = tuple(sorted((*setup.tags, *(round(float(s), 3) for s in places))))
        yield "tag", f"{len(places)} more tags, in the middle of every gap", replace(setup, tags=more)


def _pushes(setup: Setup) -> Iterator[Candidate]:
    first = setup.pushes[0]
    bench = replace(instruments(setup), curvature=sharpest(setup))
    places = tuple(s for s in AT_S if s >= min(setup.tags))
    side = 1.0 if np.sin(first.direction) >= 0.0 else -1.0
    for reach in planning.largest_pushes(setup.beam, bench, places, side * np.deg2rad(DIRECTIONS_DEG), LIMITS):
        for size in SIZES if not reach.why_not else ():
            push = replace(first, at_s=reach.at_s, direction=reach.direction, peak=size * reach.largest)
            words = f"at s = {push.at_s:.2f}, {direction_words(push.direction)}, to {push.peak:.2g} N"
            try:
                yield "push", f"push {words} instead", replace(setup, pushes=(push, *setup.pushes[1:]))
                yield "second push", f"a second push {words}", replace(setup, pushes=(*setup.pushes, push))
            except RecordingError:
                continue  # the setup itself would be refused
    yield "second push", "the same push once more", replace(setup, pushes=(*setup.pushes, first))


def sharpest(setup: Setup) -> float:
    """rad: largest |q - q0| of the planned pushes."""
    bench, bent = instruments(setup), []
    for push in setup.pushes:
        solved = planning.solve_push(setup.beam, bench, even_push(push))
        bent.append(float(np.max(np.abs(solved.q - solved.problem.q0))))
    return max(bent)


def _instruments(setup: Setup) -> Iterator[Candidate]:
    sensor = setup.sensor
    if sensor.gain_sd > GAIN_SD:
        known = replace(sensor, gain_sd=GAIN_SD)
        yield "gain", "calibrate the force with a known weight, to 1 %", replace(setup, sensor=known)
    if sensor.gain_sd > WRIST.gain_sd or sensor.reversal > 0.0:
        yield "sensor", "a six-axis force sensor at the wrist", replace(setup, sensor=WRIST)
    elif any(getattr(sensor, name) > 0.0 for name in _SENSOR_SIZES):
        yield "sensor", f"a force sensor {BETTER:g} times as good", replace(setup, sensor=better(sensor))
    seated = replace(setup, placement_sd=setup.placement_sd / BETTER, turn_sd=setup.turn_sd / BETTER)
    turn = np.rad2deg(seated.turn_sd)
    words = f"place the tags to {1e3 * seated.placement_sd:.2g} mm and {turn:.2g} deg"
    yield "placement", words, seated
    if not setup.clock_sd <= SYNCHRONISED:  # NaN: found from the data
        yield "clock", f"clocks known to {1e3 * SYNCHRONISED:g} ms", replace(setup, clock_sd=SYNCHRONISED)
    sharp = replace(setup.noise, white_xy=0.5 * setup.noise.white_xy, white_angle=0.5 * setup.noise.white_angle)
    yield "camera", "a picture of twice the pixels a millimetre, or tags twice as large", replace(setup, noise=sharp)


def better(sensor: ForceSensor) -> ForceSensor:
    return replace(sensor, **{name: getattr(sensor, name) / BETTER for name in _SENSOR_SIZES})


def _distinct(ranked: list[SetupChange]) -> tuple[SetupChange, ...]:
    kept: list[SetupChange] = []
    for change in ranked:
        alike = [k for k in kept if k.kind == change.kind]
        near = [k for k in alike if "push" in k.kind and abs(_last(k) - _last(change)) < APART]
        if change.share >= LEAST_SHARE and len(alike) < 2 and not near:
            kept.append(change)
    return tuple(kept)


def _last(change: SetupChange) -> float:
    return change.setup.pushes[0 if change.kind == "push" else -1].at_s
