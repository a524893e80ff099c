"""What recording costs: packing of the film on the tags' places, clocks that drift, time a frame.

Films of a known beam are drawn without loss, packed as `onebend record` packs them, and the tags found in both.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from onebend.lab.designs import find_design
from onebend.lab.filming import film
from onebend.lab.random_bench import CameraName, FilmRequest, filming_of
from onebend.live.recording_folder import CRF, FilmWriter
from onebend.live.sources import StampedClock, StampTiming
from onebend.recording.entries import VideoEntry
from onebend.recording.tags import Tracker
from onebend.recording.video import FilmFrame, read_frames
from onebend.records import Array

CRFS = (14, 16, 18, 20, 23)
CAMERAS: tuple[CameraName, ...] = ("hd", "full-hd", "webcam")
IDS = (0, 1, 2, 3)


def lossless(camera: CameraName, folder: Path) -> tuple[list[FilmFrame], float]:
    """Frames of a slow push, and the size of its tags, m."""
    filming = filming_of(find_design("linear"), FilmRequest(camera=camera, seconds=3.0), camera)
    push = replace(filming.bench.push, before=0.5, after=0.5)
    filming = replace(filming, scene=replace(filming.scene, crf=0), bench=replace(filming.bench, push=push))
    film(filming, folder, seed=3)
    return list(read_frames(VideoEntry(folder / "video.mp4"))), filming.tag_size


def places(frames: list[FilmFrame]) -> Array:
    """(T, m, 4, 2) px, corners as the tracker finds them."""
    tracker = Tracker(IDS)
    return np.array([tracker.step(frame.luma, frame.time).corners for frame in frames])


def packed(frames: list[FilmFrame], path: Path, crf: int) -> tuple[list[FilmFrame], float, float]:
    """The frames as they come out of a film, its size in MB a minute, and the time to pack one, s."""
    height, width = frames[0].luma.shape
    writer, begun = FilmWriter(path, (width, height), crf=crf), time.process_time()
    for frame in frames:
        writer.write(frame.luma, frame.time)
    spent = time.process_time() - begun
    writer.close()
    seconds = frames[-1].time - frames[0].time
    return list(read_frames(VideoEntry(path))), 60e-6 * path.stat().st_size / seconds, spent / len(frames)


def packing() -> None:
    """By camera and crf: how far the tags' places are from those of the film without loss."""
    print("| camera | crf | change of a tag's place, RMS [mm] | largest [mm] | film [MB/min] | to pack a frame [ms] |")
    print("| --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as name:
        for camera in CAMERAS:
            frames, size = lossless(camera, Path(name) / camera)
            true = places(frames)
            side = np.linalg.norm(true - np.roll(true, 1, axis=2), axis=-1).mean(axis=2)
            scale = 1e3 * size / np.nanmedian(side)
            for crf in CRFS:
                again, rate, spent = packed(frames, Path(name) / f"{camera}-{crf}.mp4", crf)
                away = scale * np.linalg.norm((places(again) - true).mean(axis=2), axis=-1)
                rms = float(np.sqrt(np.nanmean(away**2)))
                chosen = "**" if crf == CRF else ""
                numbers = f"{rms:.4f} | {np.nanmax(away):.4f} | {rate:.0f} | {1e3 * spent:.1f}"
                print(f"| {camera} | {chosen}{crf}{chosen} | {numbers} |")


def clocks(runs: int = 40) -> None:
    """How far a camera and a force sensor are apart whose clocks drift by up to 100 ppm each, whose stamps jitter by
    0.3 ms, and whose data come 1 ms and more late, one in fifty 100 ms, and for a tenth of the time by 30 ms."""
    print("\n| recording [s] | largest error, median of runs [ms] | worst run [ms] |\n| --- | --- | --- |")
    for seconds in (3.0, 6.0, 20.0, 60.0, 300.0):
        worst = []
        for seed in range(runs):
            rng = np.random.default_rng(seed)
            pace = 1.0 + rng.uniform(-1e-4, 1e-4, 2)
            clocks_seen = []
            for rate, own in zip((30.0, 500.0), pace, strict=True):
                moment = np.arange(0.0, seconds, 1.0 / rate)
                n = len(moment)
                delay = 0.001 + rng.exponential(0.004, n) + 0.1 * (rng.random(n) < 0.02)
                delay += 0.03 * ((moment > 0.4 * seconds) & (moment < 0.5 * seconds))
                clock = StampedClock(StampTiming(delay=0.001))
                stamps = own * moment + 3e-4 * rng.standard_normal(n)
                for stamp, arrival in zip(stamps.tolist(), (moment + delay).tolist(), strict=True):
                    clock.add(stamp, arrival)
                clocks_seen.append(clock)
            camera, force = clocks_seen
            when = np.linspace(0.0, seconds, 50)
            seen = camera.from_host(force.host(pace[1] * when, np.full(50, np.nan)))
            worst.append(float(np.abs(seen - pace[0] * when).max()))
        print(f"| {seconds:.0f} | {1e3 * np.median(worst):.2f} | {1e3 * max(worst):.2f} |")


def main() -> None:
    """Both tables."""
    packing()
    clocks()


if __name__ == "__main__":
    main()
