"""Random benches: beams, tags, mounting, cameras, scenes, sensors and clocks."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import inf, isnan, nan, radians
from typing import Literal, get_args

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.stiffness import Scaled, Table
from onebend.errors import RecordingError
from onebend.lab.bench import FRANKA, PATCH_OVER_TAG, WRIST, ForceSensor, PushProfile, RealBench
from onebend.lab.designs import Design, Kind, force_that_bends, random_stiffness
from onebend.lab.filming import Filming
from onebend.lab.rendering import Backdrop, Camera, Scene, check_name
from onebend.lab.virtual import DeclaredValues, VirtualBench, VirtualClock, VirtualTag
from onebend.options import NOT_NEGATIVE, POSITIVE, option
from onebend.progress import one_blas_thread
from onebend.records import GAIN_SD, Array

TIP = 0.97  # pushes further out slide and begin inwards only: there is no beam beyond the tip


@dataclass(frozen=True)
class Chance:
    """Probability of an effect, and the range of its size."""

    probability: float
    low: float
    high: float


@dataclass(frozen=True)
class EffectRanges:
    """Sizes are uniform, or log-uniform for those in `EVEN_IN_LOG`."""

    stretch: Chance = Chance(0.7, 0.04, 0.12)  # thickness over length: stretch and shear
    relaxation: Chance = Chance(0.6, 0.02, 0.15)  # share; its time is 0.3 to 30 s
    patches: Chance = Chance(0.5, 1.2, 3.0)  # factor on k under the tags
    rest: Chance = Chance(0.5, 0.2, 6.0)  # deg, rest turn from clamp to tip; half of it is bow
    inertia: Chance = Chance(0.5, 1.0, 1.0)  # where the mass is known
    clamp: Chance = Chance(0.4, 0.1, 1.0)  # deg at the largest moment
    slide: Chance = Chance(0.5, 0.0003, 0.003)  # m/rad
    push_off: Chance = Chance(0.6, 0.0, 0.003)  # m
    length: Chance = Chance(0.6, 0.0, 0.01)  # share
    tags: Chance = Chance(0.6, 0.0002, 0.001)  # m, sd along and across; not stated
    gain: Chance = Chance(0.6, 0.0, 0.04)  # share
    posture: Chance = Chance(0.5, 0.01, 0.05)  # share of the peak
    base_height: Chance = Chance(0.5, 0.0003, 0.004)  # m
    heights: Chance = Chance(0.5, 0.0001, 0.001)  # m, sd
    tilts: Chance = Chance(0.5, 0.5, 4.0)  # deg, sd
    droop: Chance = Chance(0.4, 0.0003, 0.004)  # m
    shake: Chance = Chance(0.5, 0.05, 0.5)  # px
    drift: Chance = Chance(0.5, 0.2, 3.0)  # px
    readout: Chance = Chance(0.5, 0.005, 0.03)  # s


LABORATORY = EffectRanges()
EFFECTS = tuple(one.name for one in fields(EffectRanges))
OF_THE_PICTURE = ("base_height", "heights", "tilts", "droop", "shake", "drift", "readout")
EVEN_IN_LOG = ("patches", "shake")
FIRST_MODE = 1.8751  # of an even cantilever: frequency = FIRST_MODE^2 sqrt(EI / (mass per length L^4))
SLOW = 0.1  # of its first frequency
RELAXATION_TIME = Chance(1.0, 0.3, 30.0)  # s


def with_random_effects(
    bench: VirtualBench, rng: np.random.Generator, ranges: EffectRanges = LABORATORY, *, tag_size: float = 0.012
) -> VirtualBench:
    """`bench` with random effects. Each has a random stream of its own: removing one changes no other.

    Nobody knows the effects beforehand, so the bench states no closer tolerances than a recording.toml that is silent
    on them.
    """
    seed = int(rng.integers(2**32))
    streams = {name: np.random.default_rng([seed, i]) for i, name in enumerate(EFFECTS)}
    size = {name: drawn(streams[name], getattr(ranges, name), log=name in EVEN_IN_LOG) for name in EFFECTS}
    sign = {name: float(streams[name].choice([-1.0, 1.0])) for name in EFFECTS}
    length, count, push = bench.beam.length, len(bench.tags), bench.push
    inwards = push.at_s > TIP
    massive = float(np.min(bench.beam.mass_per_length(np.linspace(0.0, 1.0, 11)))) > 0.0
    bow = streams["rest"].uniform(-0.5, 0.5) * np.radians(size["rest"])
    tilts = np.radians(size["tilts"]) * streams["tilts"].standard_normal((count, 2))
    heights = size["heights"] * streams["heights"].standard_normal(count)
    turn = sign["rest"] * np.radians(size["rest"])
    effects = RealBench(
        thickness=size["stretch"] * length,
        relaxation=size["relaxation"],
        relaxation_time=drawn(streams["relaxation"], RELAXATION_TIME, log=True),
        patch_factor=size["patches"] or 1.0,
        patch_length=PATCH_OVER_TAG * tag_size,
        rest_turn=(float(turn - bow), float(2.0 * bow)) if turn else (),
        inertia=massive and size["inertia"] > 0.0 and _is_slow(bench),
        clamp_compliance=float(np.radians(size["clamp"])) / (push.peak * push.at_s * length),
        slide=size["slide"] * (-float(np.sign(push.direction)) if inwards else sign["slide"]),
        push_off=size["push_off"] * (-1.0 if inwards else sign["push_off"]),
        length_off=size["length"] * sign["length"],
        posture_bias=size["posture"],
        posture_shape=tuple(streams["posture"].standard_normal(10).tolist()),
        base_height=size["base_height"] * sign["base_height"],
        tag_heights=tuple(heights.tolist()) if size["heights"] else (),
        tag_tilts=tuple((float(a), float(b)) for a, b in tilts) if size["tilts"] else (),
        droop=size["droop"],
        shake=size["shake"],
        drift=size["drift"],
        readout=size["readout"],
    )
    off: Array = size["tags"] * streams["tags"].standard_normal((count, 2))
    tags = tuple(
        replace(tag, along=tag.along + float(away[0]), across=tag.across + float(away[1]))
        for tag, away in zip(bench.tags, off, strict=True)
    )
    gain = bench.sensor.gain * (1.0 + size["gain"] * sign["gain"])
    said, usual = bench.declared, DeclaredValues.placement_sd
    gain_sd = bench.sensor.gain_sd if isnan(said.gain_sd) else said.gain_sd
    said = replace(said, rest="unknown", gain_sd=max(gain_sd, GAIN_SD), placement_sd=max(said.placement_sd, usual))
    return replace(bench, effects=effects, tags=tags, sensor=replace(bench.sensor, gain=gain), declared=said)


def _is_slow(bench: VirtualBench) -> bool:
    """Whether quasi-static accelerations are good to within the tags' scatter.

    `rod_march` uses them. Their relative error is about the fourth power of the push's frequency over the beam's first
    one.
    """
    middle = (np.arange(200) + 0.5) / 200
    compliance = 3.0 * float(np.mean((1.0 - middle) ** 2 / np.asarray(bench.beam.stiffness(middle))))
    mass = float(np.mean(bench.beam.mass_per_length(middle)))
    first = FIRST_MODE**2 / np.sqrt(compliance * mass * bench.beam.length**3)
    return bool(np.pi / min(bench.push.rise, bench.push.fall) < SLOW * first)


def drawn(rng: np.random.Generator, chance: Chance, *, log: bool = False) -> float:
    """A size; 0 if the effect is absent."""
    there = float(rng.random()) < chance.probability
    share = float(rng.random())
    if not there:
        return 0.0
    if log:
        return float(chance.low * (chance.high / chance.low) ** share)
    return chance.low + (chance.high - chance.low) * share


PushName = Literal["slow", "fast", "s08", "s06", "free"]
CameraName = Literal["hd", "full-hd", "phone", "webcam", "wide", "tilted"]
SensorName = Literal["franka", "wrist", "ideal"]

SLOW_PUSH = PushProfile(nan, before=1.5, rise=6.0, hold=1.0, fall=6.0, after=1.5)
FAST = PushProfile(nan, before=1.0, rise=2.2, hold=0.5, fall=1.6, after=1.7)
PUSHES: dict[str, PushProfile] = {
    "slow": SLOW_PUSH,
    "fast": FAST,
    "s08": replace(SLOW_PUSH, at_s=0.8, rise=3.5, fall=3.0),
    "s06": replace(SLOW_PUSH, at_s=0.6, rise=3.5, fall=3.0),
    "free": replace(FAST, hold=0.8, fall=0.03, after=4.0),
}
SWINGING = ("fast", "free")  # need the equation of motion
CAMERAS: dict[str, tuple[Camera, float]] = {  # and frames/s
    "hd": (Camera(), 30.0),
    "full-hd": (Camera(1920, 1080, 1750.0), 30.0),
    "phone": (Camera(1920, 1080, 1500.0, dist=(0.04, -0.06, 0.0003, -0.0005, 0.0), tilt=(0.06, 0.05)), 60.0),
    "webcam": (Camera(960, 540, 800.0, dist=(0.08, -0.15, 0.0008, 0.0006, 0.0), tilt=(0.05, -0.04)), 15.0),
    "wide": (Camera(focal=700.0, dist=(-0.22, 0.06, 0.0004, -0.0003, 0.0)), 30.0),
    "tilted": (Camera(tilt=(0.25, -0.12), roll=0.1), 30.0),
}
SENSORS: dict[str, tuple[ForceSensor, str]] = {  # and the name in recording.toml
    "franka": (FRANKA, "franka-estimate"),
    "wrist": (WRIST, "wrist six-axis"),
    "ideal": (ForceSensor(rate=500.0), "without errors"),
}


@dataclass(frozen=True)
class FilmRequest:
    """A requested film. NaN: the value of the named push or camera."""

    push: PushName = option("--push", "slow")
    at_s: float = option("--push-at", nan, metavar="S", within=(0.05, 1.0))
    force: float = option("--force-N", nan, within=POSITIVE)
    bend: float = option("--bend-deg", radians(65.0), within=(1.0, 150.0))
    direction: float = option("--direction-deg", nan)
    seconds: float = option("--seconds", nan, metavar="S", within=(0.05, 600.0))
    camera: CameraName = option("--camera", "hd")
    fps: float = option("--fps", nan, metavar="HZ", within=(1.0, 240.0))
    tilt: float = option("--tilt-deg", nan, within=(-45.0, 45.0))
    distance: float = option("--distance-m", nan, within=(0.05, 1e9))
    sensor: SensorName = option("--sensor", "franka")
    gravity: float = option("--gravity-m-s2", 0.0, metavar="G", within=NOT_NEGATIVE)
    base_angle: float = option("--base-angle-deg", 0.0)
    calibrated: bool = option("--uncalibrated", True)


def push_of(request: FilmRequest, beam: Beam) -> PushProfile:
    """The requested push; its peak gives the named push's bending on this beam. Raises `RecordingError`: invalid time,
    place or force."""
    asked = {"at_s": request.at_s, "direction": request.direction}
    known = {name: value for name, value in asked.items() if not isnan(value)}
    push = replace(PUSHES[check_name(request.push, PushName, "push")], **known)
    if not isnan(request.seconds):
        begin, end = push.contact
        share = request.seconds / (end - begin)
        sudden = request.push == "free"
        push = replace(
            push, rise=share * push.rise, hold=share * push.hold, fall=push.fall if sudden else share * push.fall
        )
    if not isnan(request.force):
        if not request.force > 0.0:
            raise RecordingError(f"a push needs a force above zero, got {request.force} N")
        return replace(push, peak=request.force)
    return replace(push, peak=force_that_bends(beam, request.bend, push.direction, push.at_s))


def camera_of(request: FilmRequest) -> tuple[Camera, float]:
    """With its frames/s."""
    camera, fps = CAMERAS[check_name(request.camera, CameraName, "camera")]
    if not isnan(request.tilt):
        camera = replace(camera, tilt=(request.tilt, 0.0))
    return replace(camera, distance=request.distance), fps if isnan(request.fps) else request.fps


def filming_of(design: Design, request: FilmRequest, name: str) -> Filming:
    """A design filmed as requested: well-mounted tags at thirds, and a stated clock offset that is 0.4 s off. Raises
    `RecordingError`: unknown name or invalid number."""
    beam = design.beam()
    camera, fps = camera_of(request)
    sensor, called = SENSORS[check_name(request.sensor, SensorName, "sensor")]
    bench = VirtualBench(
        beam=beam,
        push=push_of(request, beam),
        tags=(VirtualTag(1, 0.333333), VirtualTag(2, 0.666667), VirtualTag(3, 1.0)),
        sensor=sensor,
        fps=fps,
        clock=VirtualClock(offset=250.0, declared=250.4, uncertainty=2.0),
        name=name,
    )
    return Filming(
        bench,
        width=design.width,
        rotary_inertia=design.along.rotary_inertia,
        camera=camera,
        swings=request.push in SWINGING,
        gravity=request.gravity,
        base_angle=request.base_angle,
        sensor_name=called,
        calibrated=request.calibrated,
    )


PLACES = np.linspace(0.0, 1.0, 401)
DENSITY, DEPTH = 1070.0, 0.03  # kg/m^3, m
SLENDERNESS = 11.0  # length over mean width


@dataclass(frozen=True)
class BenchRanges:
    kinds: tuple[Kind, ...] = ("smooth", "smooth", "smooth", "stepped", "joint")
    sensors: tuple[SensorName, ...] = get_args(SensorName)
    pushed_at: tuple[float, ...] = (1.0, 1.0, 1.0, 0.8, 0.6)
    seconds: tuple[float, float] = (6.0, 10.0)  # of contact
    sides: tuple[tuple[int, int], ...] = ((1280, 720), (1280, 720), (1920, 1080))  # px
    fps: tuple[float, ...] = (15.0, 24.0, 30.0)
    calibrated: float = 0.7  # share of films
    effects: EffectRanges | None = None  # None: no effects


@one_blas_thread
def random_bench(rng: np.random.Generator, chance: BenchRanges = BenchRanges(), *, name: str = "drawn") -> Filming:
    """A slow push of an unknown beam. The declared tolerances are those the errors were drawn with; so is the gain's
    sd.

    Equal states of `rng` give equal benches.
    """
    beam, width = random_beam(rng, chance)
    sensor, called, gain_sd = random_sensor(rng, chance.sensors[int(rng.integers(len(chance.sensors)))])
    placement = float(rng.uniform(2e-4, 6e-4))
    tags = random_tags(rng, placement)
    offset = float(rng.uniform(20.0, 400.0))
    bench = VirtualBench(
        beam=beam,
        push=random_push(rng, beam, chance),
        tags=tags,
        base=(*rng.normal(0.0, placement, 2).tolist(), float(rng.normal(0.0, np.radians(1.0)))),
        sensor=sensor,
        fps=float(rng.choice(chance.fps)),
        clock=VirtualClock(offset, round(offset + float(rng.uniform(-1.0, 1.0)), 2), 2.0),
        declared=DeclaredValues(placement_sd=round(placement, 5), gain_sd=gain_sd),
        name=name,
    )
    filming = Filming(
        bench,
        width=width,
        camera=random_camera(rng, chance),
        scene=random_scene(rng, bench),
        tag_size=round(float(rng.uniform(0.07, 0.09)) * beam.length, 4),
        log_rotation=float(np.radians(rng.choice([0.0, 0.0, 30.0, 90.0, -135.0]))),
        log_of_robot=bool(rng.random() < 0.3),
        sensor_name=called,
        calibrated=bool(rng.random() < chance.calibrated),
        mass_told=bool(rng.random() < 0.7),
        lost=float(rng.choice([0.0, 0.0, 0.01, 0.03])),
    )
    bench = replace(bench, declared=replace(bench.declared, tag_size=filming.tag_size))
    if chance.effects is not None:
        bench = with_random_effects(bench, rng, chance.effects, tag_size=filming.tag_size)
    return as_thick(_with_bench(filming, bench))


def _with_bench(filming: Filming, bench: VirtualBench) -> Filming:
    """With this bench; its mass is told where its motion has inertia or weight."""
    heavy = bench.effects.inertia or filming.swings or filming.gravity > 0.0
    return replace(filming, bench=bench, mass_told=filming.mass_told and heavy)


def as_thick(filming: Filming) -> Filming:
    """With the drawn width equal to the thickness, if it stretches and shears."""
    thickness, k = filming.bench.effects.thickness, np.asarray(filming.bench.beam.stiffness(PLACES))
    if thickness == 0.0:
        return filming
    sizes = thickness * np.cbrt(k / float(k.mean()))
    return replace(filming, width=Table(tuple(PLACES.tolist()), tuple(sizes.tolist())))


def design_with_effects(filming: Filming, rng: np.random.Generator, ranges: EffectRanges = LABORATORY) -> Filming:
    """A filmed design with random effects; its thickness for stretch and shear follows from its width."""
    bench = with_random_effects(filming.bench, rng, ranges, tag_size=filming.tag_size)
    if bench.effects.thickness:
        thickness = float(np.cbrt(np.mean(np.asarray(filming.width(PLACES)) ** 3)))  # that of the mean k
        bench = replace(bench, effects=replace(bench.effects, thickness=thickness))
    return _with_bench(filming, bench)


def random_beam(rng: np.random.Generator, chance: BenchRanges) -> tuple[Beam, Table]:
    """A beam and its width [m]: a flat bar of one material with this k(s)."""
    length = round(float(rng.uniform(0.12, 0.30)), 3)
    kind = chance.kinds[int(rng.integers(len(chance.kinds)))]
    level = float(np.exp(rng.uniform(np.log(0.015), np.log(0.15))))
    stiffness = random_stiffness(kind, rng, level=level)
    relative = np.asarray(stiffness(PLACES)) ** (1.0 / 3.0)
    sizes = relative * (length / SLENDERNESS / float(relative.mean()))
    width = Table(tuple(PLACES.tolist()), tuple(sizes.tolist()))
    return Beam(length, stiffness, mass_per_length=Scaled(DENSITY * DEPTH, width)), width


def random_push(rng: np.random.Generator, beam: Beam, chance: BenchRanges) -> PushProfile:
    """Slow, across the beam from either side; turns the pushed place by 45 to 80 degrees."""
    at_s = float(rng.choice(chance.pushed_at))
    seconds, side = float(rng.uniform(*chance.seconds)), float(rng.choice([-1.0, 1.0]))
    direction = side * float(rng.uniform(1.45, 1.95))
    peak = force_that_bends(beam, float(np.radians(rng.uniform(45.0, 80.0))), direction, at_s)
    return PushProfile(
        peak,
        direction=direction,
        turn=side * float(rng.uniform(0.0, 0.6)),
        at_s=at_s,
        before=float(rng.uniform(1.2, 2.0)),
        rise=0.5 * seconds,
        hold=0.1 * seconds,
        fall=0.4 * seconds,
        after=float(rng.uniform(1.0, 1.8)),
    )


def random_tags(rng: np.random.Generator, placement: float) -> tuple[VirtualTag, ...]:
    """Three to five tags, the last at the tip, placed by hand with a ruler."""
    count = int(rng.integers(3, 6))
    first = int(rng.integers(1, 20))
    errors: Array = rng.normal(0.0, placement, (count, 2))
    turns = rng.normal(0.0, np.radians(0.7), count)
    return tuple(
        VirtualTag(first + i, round((i + 1) / count, 6), float(errors[i, 0]), float(errors[i, 1]), float(turns[i]))
        for i in range(count)
    )


def random_sensor(rng: np.random.Generator, name: SensorName) -> tuple[ForceSensor, str, float]:
    """A sensor, its name, and the stated sd of its gain."""
    sensor, called = SENSORS[name]
    if name == "ideal":
        return sensor, called, 0.0
    if name == "wrist":
        bias = tuple(rng.normal(0.0, 0.4, 2).tolist())
        return replace(sensor, bias=(bias[0], bias[1])), called, sensor.gain_sd
    bias = tuple((rng.normal(0.0, 1.0, 2) * float(rng.random() < 0.7)).tolist())
    drawn = replace(
        sensor,
        bias=(bias[0], bias[1]),
        reversal=float(rng.uniform(0.1, 0.3)),
        lag=float(rng.uniform(0.025, 0.05)),
        gain_sd=0.1,
        drops=float(rng.uniform(0.001, 0.007)),
    )
    return drawn, called, 0.1


def random_camera(rng: np.random.Generator, chance: BenchRanges) -> Camera:
    """Tilted by 0 to 12 degrees; lenses from a phone's to a cheap wide one's."""
    width, height = chance.sides[int(rng.integers(len(chance.sides)))]
    k1 = float(rng.uniform(-0.15, 0.08))
    tangential = rng.normal(0.0, 5e-4, 2).tolist()
    tilt = rng.uniform(0.0, 0.2) * np.array([np.cos(turn := rng.uniform(0.0, 2.0 * np.pi)), np.sin(turn)])
    return Camera(
        width=width,
        height=height,
        focal=width * float(rng.uniform(0.75, 1.2)),
        centre=(float(rng.normal(0.0, 0.008) * width), float(rng.normal(0.0, 0.008) * width)),
        dist=(k1, float(rng.uniform(-0.3, 0.0)) * k1, tangential[0], tangential[1], 0.0),
        tilt=(float(tilt[0]), float(tilt[1])),
        roll=float(rng.normal(0.0, 0.1)),
    )


def random_scene(rng: np.random.Generator, bench: VirtualBench) -> Scene:
    begin, end = bench.push.contact
    backdrops = get_args(Backdrop)
    return Scene(
        backdrop=backdrops[int(rng.integers(len(backdrops)))],
        paper=float(rng.uniform(0.75, 0.95)),
        ink=float(rng.uniform(0.06, 0.2)),
        print_dpi=float(rng.choice([600.0, 1200.0, 2400.0])),
        brightness=float(rng.uniform(0.75, 1.05)),
        falloff=float(rng.uniform(0.05, 0.4)),
        brightest=(float(rng.uniform(0.2, 0.8)), float(rng.uniform(0.2, 0.8))),
        flicker=float(rng.uniform(0.0, 0.06)),
        flicker_time=float(rng.uniform(0.5, 8.0)),
        step=float(rng.choice([0.0, 0.0, -0.2, 0.1])),
        step_at=float(rng.uniform(begin, end)),
        exposure=float(rng.uniform(0.004, 0.016)),
        blur=float(rng.uniform(0.5, 1.0)),
        noise=float(rng.uniform(0.8, 3.0)),
        overlap=float(rng.uniform(0.0, 0.004) * (rng.random() < 0.1)),
        slant=float(rng.uniform(-0.5, 0.5)),
        hand_at=float(rng.uniform(begin, end)) if rng.random() < 0.2 else inf,
        crf=int(rng.integers(16, 25)),
    )
