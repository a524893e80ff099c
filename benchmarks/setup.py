"""A point led to goals in the set-up that its beam was learned in, and with another tool and sensor.

Virtual benches with effects drawn at random (`benchmarks.real_bench`) are learned from one push. `reach` then gives the
forces for goals among the places that the recording showed, and the true beam is bent by them with all its effects
(`onebend.lab.rod`): until the true sensor shows the force. Places are those in the frame of the recording. A new tool
touches elsewhere and slides otherwise, a new sensor has another scale, other axes and another error with the posture;
both are drawn from the priors of the fit. The centre of the last tag, at the tip, is what the recording has shown; the
tip itself lies off it by the error of the tag's place.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.outline import beside, outline_of, with_end
from benchmarks.real_bench import bench_of
from onebend.beam.setup import Renewed, posture_terms
from onebend.control.reach import reach_in_setup
from onebend.errors import ControlError, LearningError, MechanicsError, ObservationError
from onebend.lab.bench import smooth
from onebend.lab.rod import RodMotion, RodTask, march
from onebend.lab.virtual import (
    VirtualBench,
    VirtualRecording,
    from_base,
    tag_places,
    tag_poses_on,
    virtual_recording,
)
from onebend.learning.allowances import POSTURE_SD, SLIDE_SD
from onebend.learning.instruments import setup_of
from onebend.learning.posterior import Posterior, fit
from onebend.recording.observe import ObserveSettings, assemble
from onebend.records import DIRECTION_SD, GAIN_SD, PLACE_SD, Array, rotated

CELLS = ("none", "small", "all")
GOALS = 4  # a bench
STEP = 0.1  # s, of the rod that is bent
PASSES = 3  # of the force that the true sensor shows
SPREAD = 0.35  # rad, of the goals' forces about the mean direction of the push
LEVELS = (0.5, 0.95)
SEEN = ("tags", "outline", "end", "both")  # "end": the outline and its end; "both": tags beside these
NEW: tuple[Renewed, ...] = ("tool", "sensor")


@dataclass(frozen=True)
class Learned:
    """A bench, and what was learned on it."""

    cell: str
    seed: int
    bench: VirtualBench
    made: VirtualRecording
    turn: float  # rad, of the recording's frame against the base tag
    posterior: Posterior


@dataclass(frozen=True)
class Led:
    """A point led to one goal."""

    cell: str
    seed: int
    new: bool  # another tool and sensor
    off: float  # m, of the true point, tip or last tag, from the goal
    quiet: float  # m, the same where the log has no new noise
    tag: float  # m, likewise, of the last tag from where the set-up says
    squared: float  # Mahalanobis distance from the predicted place
    long: float  # m, larger semi-axis of the 95 % ellipse
    claimed: float  # m, median of `off` by the ellipse
    doubted: bool


def fixed(bench: VirtualBench, seed: int) -> VirtualBench:
    """With the gain of its one sensor drawn, so that it is the same when the beam is bent."""
    sensor, rng = bench.sensor, np.random.default_rng([seed, 5])
    return replace(bench, sensor=replace(sensor, gain=sensor.gain + sensor.gain_sd * rng.standard_normal(), gain_sd=0))


def placed(bench: VirtualBench, seed: int, sd: float) -> VirtualBench:
    """With its tags placed to `sd` [m] along and across, and stated so."""
    rng = np.random.default_rng([seed, 9])
    off = rng.normal(0.0, sd, (len(bench.tags) + 1, 2)).tolist()
    tags = tuple(replace(tag, along=x, across=y) for tag, (x, y) in zip(bench.tags, off[1:], strict=True))
    said = replace(bench.declared, placement_sd=sd)
    return replace(bench, tags=tags, base=(off[0][0], off[0][1], bench.base[2]), declared=said)


def learn(cell: str, seed: int, placed_to: float = 0.0, shown: str = "tags") -> Learned:
    """Make, observe, fit; tags as they are, or `placed_to` [m]; what is `shown` as in `SEEN`."""
    bench = fixed(bench_of(cell, seed)[0], seed)
    bench = placed(bench, seed, placed_to) if placed_to else bench
    bare = shown in ("outline", "end")
    if bare:
        bench = replace(bench, effects=replace(bench.effects, patch_factor=1.0))
    made = virtual_recording(bench, seed=seed)
    described, markers = made.recording, made.markers
    if shown != "tags":
        markers = outline_of(made, np.random.default_rng([seed, 5]))
        markers = markers if shown == "outline" else with_end(made, markers, np.random.default_rng([seed, 55]))
        markers = beside(made.markers, markers) if shown == "both" else markers
        described = replace(described, tags=replace(described.tags, on_beam=())) if bare else described
    seen = assemble(described, markers, made.log, None, ObserveSettings())
    turn = float(np.nanmedian(markers.angle[seen.frame] - seen.angle))
    return Learned(cell, seed, bench, made, turn, fit([seen], gain_sd=bench.declared.gain_sd))


@dataclass(frozen=True)
class TrueSetUp:
    """The bench as it is when the beam is bent."""

    bench: VirtualBench
    turn: float  # rad, of the recording's frame against the base tag
    posture: Array  # (5, 2) N, of the sensor's error: coefficients of x, y, x^2, xy, y^2 of the tool over the length
    axes: float = 0.0  # rad, of the sensor against the beam
    noise: tuple[float, float] = (0.0, 0.0)  # N that the sensor shows beside

    def places(self, shown: Array) -> Array:
        """(2, 2) m in the recording's frame: tip and last tag once the sensor shows this force (2,) [N]."""
        wanted = rotated((shown - np.array(self.noise))[None] / self.bench.sensor.gain, -self.axes)[0]
        force, at = wanted, np.append(np.clip(tag_places(self.bench), 0.0, 1.0), 1.0)
        for _ in range(PASSES):
            motion = self.motion(force, at)
            x, y = (motion.tool[-1] - motion.tool[0]) / self.bench.beam.length
            force = wanted - np.array([x, y, x * x, x * y, y * y]) @ self.posture
        pose = motion.poses(motion.time[-1:], at)
        pose = np.concatenate([pose[:, -1:], tag_poses_on(self.bench, pose[:, :-1])[:, -1:]], axis=1)
        return rotated(from_base(pose, self.bench.base)[0, :, :2], -self.turn)

    def motion(self, force: Array, point: Array) -> RodMotion:
        """From rest to the force, as fast as in the recording, and held."""
        push, effects = self.bench.push, replace(self.bench.effects, inertia=False)

        def grown(time: Array) -> Array:
            return np.asarray(smooth(time / push.rise)[:, None] * force)

        task = RodTask(self.bench.beam, effects, tag_places(self.bench), grown, push.at_s, push.rise + push.hold)
        return march(task, STEP, at=point)


def posture_of(bench: VirtualBench, tool: Array) -> Array:
    """(5, 2) N of `TrueSetUp.posture`, where the push took the tool to these places (T, 2) [m]."""
    shape = np.asarray(bench.effects.posture_shape).reshape(2, 5).T
    terms = posture_terms((tool - tool[0]) / bench.beam.length)
    return shape * bench.effects.posture_bias * bench.push.peak / float(np.max(np.linalg.norm(terms @ shape, axis=1)))


def same(one: Learned, rng: np.random.Generator) -> TrueSetUp:
    """The set-up of the recording, with new noise of its sensor."""
    sensor, tool = one.bench.sensor, np.zeros((1, 2)) if one.made.motion is None else one.made.motion.tool
    noise = np.hypot(sensor.coloured_sd, sensor.drift * np.sqrt(one.bench.push.duration)) * rng.standard_normal(2)
    posture = posture_of(one.bench, tool) if one.bench.effects.posture_bias else np.zeros((5, 2))
    return TrueSetUp(one.bench, one.turn, posture, noise=(float(noise[0]), float(noise[1])))


def renewed(one: Learned, rng: np.random.Generator) -> TrueSetUp:
    """Another tool and another sensor, drawn as the priors of the fit have them."""
    before, bench = same(one, rng), one.bench
    off, slide = rng.normal(0.0, PLACE_SD), rng.normal(0.0, SLIDE_SD)
    beyond = bench.beam.length * (bench.push.at_s - 1.0) + off
    off = off - 2.0 * beyond if beyond > 0.0 else off  # there is no beam
    effects = replace(bench.effects, push_off=float(off), slide=float(slide))
    sensor = replace(bench.sensor, gain=1.0 + float(rng.normal(0.0, GAIN_SD)))
    tool = one.made.pose[:, -1, :2] if one.made.motion is None else one.made.motion.tool
    largest = float(np.max(np.linalg.norm(posture_terms((tool - tool[0]) / bench.beam.length), axis=1)))
    posture = POSTURE_SD * bench.push.peak * rng.standard_normal((5, 2)) / max(largest, 1e-9)
    axes = float(rng.normal(0.0, DIRECTION_SD))
    return replace(before, bench=replace(bench, effects=effects, sensor=sensor), posture=posture, axes=axes)


def led(one: Learned, *, with_new: bool = True, tag: bool = False) -> list[Led]:
    """The tip, or the last `tag`, led to goals in the set-up of the recording, and to the same ones with new parts."""
    setup, known, beam = setup_of(one.posterior), one.posterior.stiffness, one.posterior.beam
    assert setup is not None
    aim = setup.tag_ids[-1] if tag else None
    rng = np.random.default_rng([one.seed, 7])
    push, out, normal = one.bench.push, list[Led](), np.random.default_rng(0).standard_normal((4000, 2))
    for _ in range(GOALS):
        size, turn = push.peak * rng.uniform(0.4, 1.0), push.direction + SPREAD * rng.uniform(-1.0, 1.0)
        shown = one.bench.sensor.gain * size * np.array([np.cos(turn), np.sin(turn)])
        goal = setup.bent(beam, known, shown[None]).point(1.0, aim)[0]
        for new in (False, True):
            there = renewed(one, rng) if new else same(one, rng)
            if new and not with_new:
                continue  # the draws of the goals stay the same
            found = reach_in_setup(beam, known, setup, goal, push_s=push.at_s, tag=aim, new=NEW if new else ())
            place = there.places(found.force)[int(tag)]
            quiet = replace(there, noise=(0.0, 0.0)).places(found.force)
            to = np.stack([found.way.xy(np.array([1.0]))[-1, 0] if tag else goal, found.way.tags()[-1, -1, :2]])
            off, tip, last = np.linalg.norm([place - goal, *(quiet - to)], axis=1).tolist()
            squared, long = float(found.predicted.distance(place)), float(found.predicted.ellipse().semi_axes[0])
            likely = np.linalg.norm(normal @ np.linalg.cholesky(found.predicted.covariance).T, axis=1)
            doubted = bool(one.posterior.doubts)
            exact, last = last if tag else tip, last if setup.tag_ids[-1] >= 0 else np.nan
            out.append(Led(one.cell, one.seed, new, off, exact, last, squared, long, float(np.median(likely)), doubted))
    return out


def run(cell: str, seed: int, placed_to: float = 0.0, tag: bool = False, shown: str = "tags") -> list[Led] | str:
    """One bench; why not, where it cannot be made, learned or bent."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    try:
        return led(learn(cell, seed, placed_to, shown), tag=tag)
    except (ControlError, LearningError, MechanicsError, ObservationError) as wrong:
        return f"{cell} {seed}: {type(wrong).__name__}: {wrong}"


def row(name: str, goals: Sequence[Led]) -> str:
    """The table's row of goals on some benches."""
    sizes = zip(*((g.off, g.quiet, g.tag) for g in goals), strict=True)
    off, quiet, tag = (1e3 * np.quantile(which, [0.5, 0.9]) for which in sizes)  # the last NaN without tags
    inside = [100.0 * np.mean([one.squared <= -2.0 * np.log1p(-level) for one in goals]) for level in LEVELS]
    long, claimed = (1e3 * float(np.median([getattr(one, name) for one in goals])) for name in ("long", "claimed"))
    return (
        f"| {name} | {len({one.seed for one in goals})} | {len(goals)} | {off[0]:.2f} | {claimed:.2f} | {off[1]:.2f} "
        f"| {quiet[0]:.2f} / {quiet[1]:.2f} | {tag[0]:.2f} / {tag[1]:.2f} "
        f"| {' / '.join(f'{share:.0f}' for share in inside)} | {long:.1f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="benches of each cell")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("--cells", nargs="*", default=CELLS, choices=CELLS, help="effects")
    parser.add_argument("--placed-mm", type=float, default=0.0, help="place all tags so well, and state it")
    parser.add_argument("--tag", action="store_true", help="lead the last tag in place of the tip")
    parser.add_argument(
        "--shown",
        default="tags",
        choices=SEEN,
        help="what the camera sees of the body: tags, a bare outline without its end or with it, tags beside these",
    )
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    asked = parser.parse_args()
    benches = [(cell, asked.first + i) for cell in asked.cells for i in range(asked.runs)]
    wanted = [(*one, 1e-3 * asked.placed_mm, asked.tag, asked.shown) for one in benches]
    goals: list[Led] = []
    with ProcessPoolExecutor(asked.jobs) as pool:
        for found in pool.map(run, *zip(*wanted, strict=True)):
            if isinstance(found, str):
                print(found, file=sys.stderr, flush=True)
            else:
                goals += found
    levels = " / ".join(f"{100 * level:.0f}" for level in LEVELS)
    heads = ["effects", "benches", "goals", f"{'last tag' if asked.tag else 'tip'} off, median [mm]"]
    heads += ["as claimed [mm]", "90 % [mm]"]
    heads += ["the same without new noise of the log [mm]", "likewise the last tag [mm]"]
    heads += [f"inside the {levels} % ellipse [%]"]
    print(f"| {' | '.join(heads)} | larger semi-axis, 95 % [mm] |")
    print("| --- " * 10 + "|")
    for cell in asked.cells:
        for new in (False, True):
            some = [one for one in goals if (one.cell, one.new) == (cell, new)]
            if some:
                print(row(f"{cell}, {'new tool and sensor' if new else 'same set-up'}", some))


if __name__ == "__main__":
    main()
