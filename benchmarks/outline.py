"""How reliable k(s) is from tags, from an outline, and from both: virtual pushes without effects, with one, with all.

The benches are those of `benchmarks.real_bench`: none, one at a time, or all (`small`: within the priors). A body
without tags has no stiff patches. An outline is 30 points with white noise across it, an error that is smooth along the
body and slow in time, one that grows with the bending, and light from one side; with its end where asked for. Shares
are of places s from 0.05 to 0.9 of the push's place.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import real_bench
from benchmarks.real_bench import CELLS, LEVELS, PLACES as COUNT, bench_of
from onebend.errors import LearningError, MechanicsError, ObservationError
from onebend.lab.bench import coloured
from onebend.lab.virtual import VirtualBench, VirtualRecording, from_base, standing, true_stiffness, virtual_recording
from onebend.learning.start import start_of
from onebend.live.replayed import replay
from onebend.recording.observe import ObserveSettings, assemble
from onebend.recording.outline import PLACES
from onebend.records import END_ID, POINT_ID, Array, Markers, Observations

WHITE, SLOW, GROWS, LIGHT, END = 2e-5, 3e-5, 4e-5, 1e-4, 2e-4  # m, one sd
SLOW_TIME, TERMS = 1.0, 6  # s; Legendre polynomials along the body
KINDS = ("tags", "outline", "both")
CUT = 0.3  # of the largest force: with less, film and log of the kind "cut" show nothing


def poses_at(made: VirtualRecording, s: Array) -> Array:
    """(T, n, 3) of the true beam at places s (n,), as the base tag has them."""
    bench = made.bench
    if made.motion is None:
        return from_base(standing(bench.beam, made.force, bench.push.at_s, s), bench.base)
    return from_base(made.motion.poses(made.markers.time, s), bench.base)


def outline_of(made: VirtualRecording, rng: np.random.Generator) -> Markers:
    """The outline's points in every frame."""
    bench, time, pose = made.bench, made.markers.time, poses_at(made, PLACES)
    across = np.stack([-np.sin(pose[..., 2]), np.cos(pose[..., 2])], axis=-1)
    along = np.polynomial.legendre.legvander(2.0 * PLACES - 1.0, TERMS - 1) / np.sqrt(TERMS)
    away = np.linalg.norm(pose[:, -1, :2] - pose[0, -1, :2], axis=-1)
    slow = [coloured(len(time), 1.0 / bench.fps, SLOW_TIME, rng) for _ in range(TERMS // 2)]
    error = WHITE * rng.standard_normal(pose.shape[:2]) + SLOW * np.concatenate(slow, axis=1) @ along.T
    error += GROWS * (away / away.max())[:, None] * (along @ rng.standard_normal(TERMS))
    error += across @ (LIGHT * rng.standard_normal(2))
    frames = 2.0 * SLOW_TIME * bench.fps  # that an error lasts
    sd = np.sqrt(WHITE**2 + frames * SLOW**2) * np.array([1.0, 1.0, 100.0])
    m = len(PLACES)
    return replace(
        made.markers,
        tag_id=POINT_ID + np.rint(1e3 * PLACES).astype(int),
        s=PLACES,
        xy=pose[..., :2] + error[..., None] * across,
        angle=pose[..., 2],
        covariance=np.tile(np.diag(sd**2), (len(time), m, 1, 1)),
        traced=np.ones(m, dtype=bool),
    )


def with_end(made: VirtualRecording, outline: Markers, rng: np.random.Generator) -> Markers:
    """The outline and the body's end, off by one number along the body in all frames."""
    time, tip = made.markers.time, np.ones(1)
    pose = poses_at(made, tip)
    along = np.stack([np.cos(pose[..., 2]), np.sin(pose[..., 2])], axis=-1)
    sd = END * np.sqrt(len(time)) * np.array([1.0, 1.0, 100.0])
    end = replace(
        outline,
        tag_id=np.array([END_ID]),
        s=tip,
        xy=pose[..., :2] + END * rng.standard_normal() * along,
        angle=pose[..., 2],
        covariance=np.tile(np.diag(sd**2), (len(time), 1, 1, 1)),
        traced=np.ones(1, dtype=bool),
    )
    return replace(beside(outline, end), traced=np.ones(len(outline.s) + 1, dtype=bool))


def beside(tags: Markers, outline: Markers) -> Markers:
    """Both, in the order of their places."""
    s = np.concatenate([tags.s, outline.s])
    order = np.argsort(s, kind="stable")

    def joined(name: str, axis: int) -> Any:
        return np.take(np.concatenate([getattr(tags, name), getattr(outline, name)], axis=axis), order, axis=axis)

    return replace(
        tags,
        tag_id=joined("tag_id", 0),
        s=s[order],
        xy=joined("xy", 1),
        angle=joined("angle", 1),
        covariance=joined("covariance", 1),
        traced=order >= len(tags.s),
    )


def cut(made: VirtualRecording) -> VirtualRecording:
    """Its tags and its log from where the push has begun to where it has not ended: neither shows a rest."""
    size, one, logged = np.linalg.norm(made.force, axis=1), made.markers, made.log.time - made.bench.clock.offset
    kept = size > CUT * size.max()
    of_frames = {name: getattr(one, name)[kept] for name in ("time", "xy", "angle", "covariance", "base_angle")}
    rows = (logged >= one.time[kept][0]) & (logged <= one.time[kept][-1])
    log = replace(made.log, time=made.log.time[rows], force=made.log.force[rows])
    return replace(made, markers=replace(one, **of_frames), log=log)


def observed(kind: str, bench: VirtualBench, seed: int) -> tuple[Observations, VirtualRecording]:
    """One push, of a body without tags where it is of the outline alone."""
    if kind == "outline":
        bench = replace(bench, effects=replace(bench.effects, patch_factor=1.0))
    made = virtual_recording(bench, seed=seed)
    rec, markers = made.recording, made.markers
    if kind == "cut":
        made = cut(made)
        markers = made.markers
    elif kind != "tags":
        outline = outline_of(made, np.random.default_rng([seed, 5]))
        markers = beside(markers, outline) if kind == "both" else outline
        rec = rec if kind == "both" else replace(rec, tags=replace(rec.tags, on_beam=()))
    return assemble(rec, markers, made.log, None, ObserveSettings()), made


@dataclass(frozen=True)
class LiveOutcome:
    """One result against its truth."""

    error: float  # RMS of log k
    inside: tuple[float, ...]  # share of places inside the bands of LEVELS
    width: float  # half the 95 % band of log k, median


def live(cell: str, kind: str, seed: int) -> LiveOutcome:
    """Make, observe, learn live, compare: its band as it is, whatever the verdict."""
    bench, _ = bench_of(cell, seed)
    seen, made = observed(kind, bench, seed)
    s = np.linspace(0.05, 0.9 * bench.push.at_s, COUNT)
    truth = true_stiffness(made.bench, made.motion, s).k
    stiffness = replay(seen, start_of([seen], None), gain_sd=bench.declared.gain_sd).stiffness
    bands = [stiffness.band(s, level) for level in LEVELS]
    error = float(np.sqrt(np.mean((stiffness.log_at(s)[0] - np.log(truth)) ** 2)))
    inside = tuple(float(np.mean((truth > b.low) & (truth < b.high))) for b in bands)
    return LiveOutcome(error, inside, float(np.median(0.5 * np.log(bands[-1].high / bands[-1].low))))


def print_live(cells: list[str], kinds: list[str], seeds: range) -> None:
    """The table of what is learned live."""
    done: dict[str, list[LiveOutcome]] = defaultdict(list)
    for cell, kind, seed in ((c, k, s) for s in seeds for c in cells for k in kinds):
        try:
            done[f"{kind}: {cell}"].append(live(cell, kind, seed))
        except (LearningError, MechanicsError, ObservationError) as wrong:
            print(f"seed {seed}, {kind}: {wrong}", file=sys.stderr)
    print("| learned live from | pushes | error, median / mean | inside the 50 / 80 / 95 % band | half-width |")
    print("| --- " * 5 + "|")
    for name, runs in done.items():
        error = np.array([one.error for one in runs])
        inside = " / ".join(f"{100.0 * v:.0f}" for v in np.mean([one.inside for one in runs], axis=0))
        width = np.median([one.width for one in runs])
        print(f"| {name} | {len(runs)} | {np.median(error):.3f} / {np.mean(error):.3f} | {inside} % | {width:.3f} |")


def run(cell: str, seed: int) -> real_bench.Outcome:
    """As `real_bench.run`, of a kind and its effects."""
    return real_bench.run(cell, seed, partial(observed, cell.split(": ")[0]))


GROUPS = {"none": ("none",), "one": tuple(c for c in CELLS if c.startswith("only")), "all": ("all", "small")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 20), metavar=("FIRST", "LAST"))
    parser.add_argument("--cells", nargs="+", default=list(CELLS), choices=CELLS, help="effects, each of every seed")
    parser.add_argument("--share", type=int, default=1, help="take one of so many seeds of each single effect")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=(*KINDS, "cut"), help="cut: tags, no rest")
    parser.add_argument("--live", action="store_true", help="learned live, no fits")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--kept", type=Path, help="file that the runs are added to; default: one a version of the code")
    asked = parser.parse_args()
    if asked.live:
        print_live(asked.cells, asked.kinds, range(*asked.seeds))
        return
    wanted = [
        (f"{kind}: {cell}", seed)
        for number, cell in enumerate(asked.cells)
        for seed in range(*asked.seeds)
        if not cell.startswith("only") or (seed + number) % asked.share == 0
        for kind in asked.kinds
        if (kind, cell) != ("outline", "only patches")
    ]
    every = list(real_bench.study(wanted, asked.jobs, asked.kept or real_bench.kept("outline"), run).values())
    print(real_bench.head())
    for kind in asked.kinds:
        own = [one for one in every if one.cell.startswith(f"{kind}: ")]
        for name, cells in GROUPS.items():
            if here := [one for one in own if one.cell.split(": ")[1] in cells]:
                print(real_bench.row(f"{kind}: {name}", here))
    good = [one for one in every if not one.failure]
    print(real_bench.row("all of these", every))
    for kind in asked.kinds:
        own = [one for one in good if one.cell.startswith(f"{kind}: ")]
        print(f"\nFrom {kind}:\n\n{real_bench.reliability(own)}\n\n{real_bench.named_first(own)}")


if __name__ == "__main__":
    main()
