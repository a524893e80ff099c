"""Benches drawn at random: beams, tags, mounting, cameras, scenes, sensors and clocks as laboratories have them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import get_args

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.stiffness import Scaled, Table
from onebend.blas import one_blas_thread
from onebend.lab.film_request import SENSORS, SensorName
from onebend.lab.filming.film_setup import Filming
from onebend.lab.filming.scene import Backdrop, Scene
from onebend.lab.filming.viewpoint import Camera
from onebend.lab.pushes import PushProfile
from onebend.lab.random_beams import Kind, force_that_bends, random_stiffness
from onebend.lab.random_effects import LABORATORY, EffectRanges, with_random_effects
from onebend.lab.sensors import ForceSensor
from onebend.lab.virtual import DeclaredValues, VirtualBench, VirtualClock, VirtualTag
from onebend.records import Array

PLACES = np.linspace(0.0, 1.0, 401)
DENSITY, DEPTH = 1070.0, 0.03  # kg/m^3, m
SLENDERNESS = 11.0  # lengths over mean widths


@dataclass(frozen=True)
class BenchRanges:
    """The ranges to draw from."""

    kinds: tuple[Kind, ...] = ("smooth", "smooth", "smooth", "stepped", "joint")
    sensors: tuple[SensorName, ...] = get_args(SensorName)
    pushed_at: tuple[float, ...] = (1.0, 1.0, 1.0, 0.8, 0.6)
    seconds: tuple[float, float] = (6.0, 10.0)  # of contact
    sides: tuple[tuple[int, int], ...] = ((1280, 720), (1280, 720), (1920, 1080))  # px
    fps: tuple[float, ...] = (15.0, 24.0, 30.0)
    calibrated: float = 0.7  # share of films
    effects: EffectRanges | None = None  # of real benches; None: no effects


@one_blas_thread
def random_bench(rng: np.random.Generator, chance: BenchRanges = BenchRanges(), *, name: str = "drawn") -> Filming:
    """A slow push of an unknown beam. The declared tolerances are those that errors were drawn from.

    The force's gain is declared with its sd, as the maker of a sensor would. The same state of `rng` gives the same
    bench.
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
    filming = replace(filming, bench=bench)
    if chance.effects is None:
        return filming
    return as_thick(replace(filming, bench=with_random_effects(bench, rng, chance.effects, tag_size=filming.tag_size)))


def as_thick(filming: Filming) -> Filming:
    """With a beam drawn as wide as it is thick, where it stretches and shears."""
    thickness, k = filming.bench.effects.thickness, np.asarray(filming.bench.beam.stiffness(PLACES))
    if thickness == 0.0:
        return filming
    sizes = thickness * np.cbrt(k / float(k.mean()))
    return replace(filming, width=Table(tuple(PLACES.tolist()), tuple(sizes.tolist())))


def design_with_effects(filming: Filming, rng: np.random.Generator, ranges: EffectRanges = LABORATORY) -> Filming:
    """A filmed design with effects that are drawn; where it stretches and shears, it is as thick as its width says."""
    bench = with_random_effects(filming.bench, rng, ranges, tag_size=filming.tag_size)
    if bench.effects.thickness:
        thickness = float(np.cbrt(np.mean(np.asarray(filming.width(PLACES)) ** 3)))  # that of the mean k
        bench = replace(bench, effects=replace(bench.effects, thickness=thickness))
    return replace(filming, bench=bench)


def random_beam(rng: np.random.Generator, chance: BenchRanges) -> tuple[Beam, Table]:
    """A beam, and its width [m] as drawn: that of a flat bar of one material with this k(s)."""
    length = round(float(rng.uniform(0.12, 0.30)), 3)
    kind = chance.kinds[int(rng.integers(len(chance.kinds)))]
    level = float(np.exp(rng.uniform(np.log(0.015), np.log(0.15))))
    stiffness = random_stiffness(kind, rng, level=level)
    relative = np.asarray(stiffness(PLACES)) ** (1.0 / 3.0)
    sizes = relative * (length / SLENDERNESS / float(relative.mean()))
    width = Table(tuple(PLACES.tolist()), tuple(sizes.tolist()))
    return Beam(length, stiffness, mass_per_length=Scaled(DENSITY * DEPTH, width)), width


def random_push(rng: np.random.Generator, beam: Beam, chance: BenchRanges) -> PushProfile:
    """Slow, across the beam from either side; it turns the pushed place by 45 to 80 degrees."""
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
    """Three to five tags, the last at the tip, put on by hand with a ruler."""
    count = int(rng.integers(3, 6))
    first = int(rng.integers(1, 20))
    errors: Array = rng.normal(0.0, placement, (count, 2))
    turns = rng.normal(0.0, np.radians(0.7), count)
    return tuple(
        VirtualTag(first + i, round((i + 1) / count, 6), float(errors[i, 0]), float(errors[i, 1]), float(turns[i]))
        for i in range(count)
    )


def random_sensor(rng: np.random.Generator, name: SensorName) -> tuple[ForceSensor, str, float]:
    """A sensor of one kind, what it is called, and the sd of its gain as told."""
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
    """From straight above to 12 degrees tilted, lenses from a phone's to a cheap wide one's."""
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
    """Table, light, tool, hand and noise."""
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
