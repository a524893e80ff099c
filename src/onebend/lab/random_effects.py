"""Effects of real benches drawn at random: each with a probability and a range of sizes, as laboratories have them."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from onebend.errors import RecordingError
from onebend.lab.effects.real_bench import PATCH_OVER_TAG, RealBench
from onebend.lab.virtual import VirtualBench
from onebend.records import Array

TIP = 0.97  # pushes further out slide and begin inwards alone: beyond the tip there is no beam


@dataclass(frozen=True)
class Chance:
    """An effect is there with this probability, with a size between `low` and `high`."""

    probability: float
    low: float
    high: float


@dataclass(frozen=True)
class EffectRanges:
    """Of every effect. Sizes are uniform between their ends, those of `EVEN_IN_LOG` in their logarithm."""

    stretch: Chance = Chance(0.7, 0.04, 0.12)  # thickness over length: stretch and shear
    relaxation: Chance = Chance(0.6, 0.02, 0.15)  # share; its time is 0.3 to 30 s
    patches: Chance = Chance(0.5, 1.2, 3.0)  # factor of k under the tags
    rest: Chance = Chance(0.5, 0.2, 6.0)  # deg, turn at rest from clamp to tip; half as much of it bows
    inertia: Chance = Chance(0.5, 1.0, 1.0)  # where the mass is known
    clamp: Chance = Chance(0.4, 0.1, 1.0)  # deg at the largest moment
    slide: Chance = Chance(0.5, 0.0003, 0.003)  # m/rad
    push_off: Chance = Chance(0.6, 0.0, 0.003)  # m
    length: Chance = Chance(0.6, 0.0, 0.01)  # share
    tags: Chance = Chance(0.6, 0.0002, 0.001)  # m, sd along and across the beam, none of it stated
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


def only(*names: str, ranges: EffectRanges = LABORATORY) -> EffectRanges:
    """The effects `names` for certain, and no other one.

    Raises:
        RecordingError: a name that is not one of `EFFECTS`.
    """
    unknown = [name for name in names if name not in EFFECTS]
    if unknown:
        raise RecordingError(f"there is no effect {unknown[0]!r}. Take of {', '.join(EFFECTS)}.")
    chance = {name: replace(getattr(ranges, name), probability=float(name in names)) for name in EFFECTS}
    return EffectRanges(**chance)


def with_random_effects(
    bench: VirtualBench, rng: np.random.Generator, ranges: EffectRanges = LABORATORY, *, tag_size: float = 0.012
) -> VirtualBench:
    """`bench` with effects that are drawn. Each draws from a stream of its own: to leave one out changes no other."""
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
    return replace(bench, effects=effects, tags=tags, sensor=replace(bench.sensor, gain=gain))


def _is_slow(bench: VirtualBench) -> bool:
    """Whether accelerations of the beam without inertia are those with it, but for less than tags scatter by.

    `rod_march` takes the first for the second. What it leaves out is about the square of the push's frequency over the
    beam's first one, squared once more.
    """
    middle = (np.arange(200) + 0.5) / 200
    compliance = 3.0 * float(np.mean((1.0 - middle) ** 2 / np.asarray(bench.beam.stiffness(middle))))
    mass = float(np.mean(bench.beam.mass_per_length(middle)))
    first = FIRST_MODE**2 / np.sqrt(compliance * mass * bench.beam.length**3)
    return bool(np.pi / min(bench.push.rise, bench.push.fall) < SLOW * first)


def drawn(rng: np.random.Generator, chance: Chance, *, log: bool = False) -> float:
    """A size; 0 where the effect is not there."""
    there = float(rng.random()) < chance.probability
    share = float(rng.random())
    if not there:
        return 0.0
    if log:
        return float(chance.low * (chance.high / chance.low) ** share)
    return chance.low + (chance.high - chance.low) * share
