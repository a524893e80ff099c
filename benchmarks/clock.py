"""Clock offset, contact and force of the development recordings against their truth.

`offset error` counts the sensor's own lag as part of the offset. `bound` is the best any method could do: one sd of the
offset found by somebody who knows the true force exactly and the statistics of the sensor's true noise (Cramer-Rao),
from the recording at hand. `force` is the RMS error over the frames in contact, x and y, with the zero from the rest
before contact only, and from all rests. `contact` is the frame of the first contact found after the first frame with
more than 1 % of the largest true force.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.studies import bench_of
from benchmarks.truth import RECORDINGS, Truth, read_truth
from onebend.lab.virtual import virtual_recording
from onebend.recording.camera import measure_markers
from onebend.recording.clock_evidence import LinearModel, fit_noise
from onebend.recording.entries import Recording
from onebend.recording.folder import read_recording
from onebend.recording.force import (
    Contact,
    cleaned,
    find_contact,
    force_at,
    match_clocks,
    read_log,
    to_beam,
)
from onebend.recording.force_noise import TimeSpans, covariance, first_guess
from onebend.recording.tags import detect_tags
from onebend.recording.tracks import with_angles
from onebend.records import Array, ForceLog, Markers

VIRTUAL = tuple(
    f"{kind} {errors}"
    for kind, errors in (
        ("smooth", "white"),
        ("smooth", "correlated"),
        ("smooth", "everything"),
        ("smooth", "stages"),
        ("smooth", "franka"),
        ("stepped", "correlated"),
        ("joint", "everything"),
    )
)


@dataclass(frozen=True)
class Row:
    """One recording with a force log."""

    name: str
    said_error: float  # s, of what recording.toml says
    offset_error: float  # s
    offset_sd: float  # s, claimed
    bound: float  # s
    cutoff: float  # Hz
    force_first: Array  # (2,) N, zero from the first rest only
    force_all: Array  # (2,) N
    force_sd: Array  # (2,) N, claimed
    contact_error: float  # s


def row(folder: Path) -> Row | None:
    """Measure one recording; None without a force log."""
    rec, truth = read_recording(folder), read_truth(folder)
    log = read_log(rec)
    if log is None or rec.video is None:
        return None
    markers = measure_markers(detect_tags(rec.video, rec.tags), rec)
    return compare(rec, markers, log, truth)


def compare(rec: Recording, markers: Markers, log: ForceLog, truth: Truth) -> Row:
    """What `observe` does with markers and log, each step beside the truth."""
    read, fit = match_clocks(rec, markers, log, None)
    assert read is not None
    contact = find_contact(markers, read, offset=fit.clock.offset)
    true = truth.facts["clock"]["log_minus_video_true"] + truth.facts["force"]["lag"]
    clean = cleaned(rec, read, contact, fit)
    first = cleaned(rec, read, replace(contact, rests=contact.rests[:1]), fit)
    size = np.linalg.norm(truth.force, axis=1)
    begin = float(truth.time[int(np.argmax(size > 0.01 * size.max()))])
    assert rec.video is not None
    return Row(
        name=rec.name,
        said_error=rec.video.start - true,
        offset_error=fit.clock.offset - true,
        offset_sd=fit.clock.sd,
        bound=bound(rec, log, truth, true),
        cutoff=clean.cutoff,
        force_first=error(force_at(first, markers.time + fit.clock.offset)[0], truth, contact),
        force_all=error(force_at(clean, markers.time + fit.clock.offset)[0], truth, contact),
        force_sd=clean.noise_sd,
        contact_error=float(markers.time[np.argmax(contact.loaded)]) - begin,
    )


def error(force: Array, truth: Truth, contact: Contact) -> Array:
    """(2,) N RMS error over the frames in contact."""
    return np.asarray(np.sqrt(np.nanmean((force - truth.force)[contact.loaded] ** 2, axis=0)))


def bound(rec: Recording, log: ForceLog, truth: Truth, offset: float, rate: float = 20.0) -> float:
    """Cramer-Rao bound on the offset, s: true force known up to a constant, true noise known up to its fitted sizes."""
    assert rec.force is not None
    force = log.force @ to_beam(rec.force.rotation)
    at = np.arange(max(log.time[0], truth.log_time[0] + offset) + 0.1, log.time[-1] - 0.1, 1 / rate)
    edges = np.concatenate([at - 0.5 / rate, [at[-1] + 0.5 / rate]])
    index = np.searchsorted(edges, log.time) - 1
    noise = np.stack(
        [
            [np.median((column - exact)[index == i]) for i in range(len(at))]
            for column, exact in zip(force.T, true_at(truth, log.time - offset).T, strict=True)
        ],
        axis=1,
    )
    constant = LinearModel(np.full((len(at), 1), 10.0), 1, noise)
    model = fit_noise(at, constant, first_guess(noise, 1 / rate))
    root = np.linalg.cholesky(covariance(model, TimeSpans.at(at)))
    step = 0.5 / rate
    slope = (true_at(truth, at - offset + step) - true_at(truth, at - offset - step)) / (2 * step)
    level = np.linalg.solve(root, np.ones(len(at)))
    told = np.linalg.solve(root, slope)
    told -= np.outer(level, level @ told) / (level @ level)
    return float(1 / np.sqrt(np.sum(told**2)))


def true_at(truth: Truth, time: Array) -> Array:
    """(N, 2) N noise-free force at `time` [s, video clock]."""
    return np.stack([np.interp(time, truth.log_time, column) for column in truth.log_force.T], axis=1)


def rows(recordings: Path = RECORDINGS) -> list[Row]:
    """All recordings with a force log."""
    found = [row(folder) for folder in sorted(recordings.iterdir()) if (folder / "recording.toml").is_file()]
    return [each for each in found if each is not None]


def markdown(found: list[Row]) -> str:
    """The rows as a table, and their summary."""
    lines = [
        "| recording | said [s] | offset error [ms] | claimed sd | bound | cut-off [Hz] | force, first rest [mN] "
        "| force, all rests [mN] | claimed [mN] | contact [s] |",
        "| --- " * 10 + "|",
    ]
    for r in found:
        first, every, claimed = (
            ", ".join(f"{1e3 * v:.1f}" for v in values) for values in (r.force_first, r.force_all, r.force_sd)
        )
        lines.append(
            f"| {r.name} | {r.said_error:+.2f} | {1e3 * r.offset_error:+.0f} | {1e3 * r.offset_sd:.0f} "
            f"| {1e3 * r.bound:.0f} | {r.cutoff:.2f} | {first} | {every} | {claimed} | {r.contact_error:+.2f} |"
        )
    within = sum(abs(r.offset_error) <= 0.015 for r in found)
    reachable = sum(r.bound <= 0.015 for r in found)
    score = np.sqrt(np.mean([(r.offset_error / r.offset_sd) ** 2 for r in found]))
    lines += [
        "",
        f"Offsets within 15 ms: {within} of {len(found)}; recordings whose bound is below 15 ms: {reachable}. "
        f"RMS of error over claimed sd: {score:.2f}.",
    ]
    return "\n".join(lines)


def virtual_row(cell: str, runs: int) -> str:
    """Errors of the clock over virtual recordings of one kind of `benchmarks.studies`, whose clock is written down
    wrong by up to 1.5 s. Without the fit of k(s)."""
    kind, errors = cell.split()
    found = []
    for seed in range(runs):
        bench = bench_of(kind, errors, seed)  # type: ignore[arg-type]
        said = bench.clock.offset + float(np.random.default_rng([seed, 9]).uniform(-1.5, 1.5))
        made = virtual_recording(replace(bench, clock=replace(bench.clock, declared=said, uncertainty=2.0)), seed=seed)
        markers = with_angles(made.markers)
        clock = match_clocks(made.recording, markers, made.log, None)[1].clock
        found.append((clock.offset - bench.clock.offset - bench.sensor.lag, clock.sd))
    miss, sd = np.array(found).T
    score = miss / sd
    return (
        f"| {cell} | {runs} | {1e3 * np.sqrt(np.mean(miss**2)):.1f} | {1e3 * np.median(np.abs(miss)):.1f} "
        f"| {1e3 * np.median(sd):.1f} | {np.sqrt(np.mean(score**2)):.2f} | {int(np.sum(np.abs(score) > 3))} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=Path, default=RECORDINGS)
    parser.add_argument("--virtual", type=int, default=0, metavar="RUNS", help="of each virtual kind instead")
    parser.add_argument("--cells", nargs="*", default=VIRTUAL, metavar="CELL", help=f"default: {', '.join(VIRTUAL)}")
    asked = parser.parse_args()
    if not asked.virtual:
        print(markdown(rows(asked.recordings)))
        return
    print(
        "| beams, errors | runs | RMS error [ms] | median error [ms] | median sd [ms] | RMS of error / sd | over 3 sd |"
    )
    print("| --- " * 7 + "|")
    for cell in asked.cells:
        print(virtual_row(cell, asked.virtual), flush=True)


if __name__ == "__main__":
    main()
