"""One recording, learned: processor time and memory of the whole process, with the report and without.

The film is searched for its tags every time; the modules' bytecode and Matplotlib's list of fonts are kept from a run
before, as they are where onebend is installed. Processor time is that of all threads, system time included; its floor
is `goal`. Stages are seconds of the wall, so they depend on what else the machine does. Floors are the processor time
of what the libraries do by themselves, without a line of onebend: loading them, decoding the film, and the tag detector
in every frame, in a part around every tag (cut by who knows already where the tags are) and in the whole picture.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.truth import RECORDINGS
from onebend.recording.folder import read_recording
from onebend.recording.tags import detect_tags

NAME = "linear_train"  # 18 s at 30 frames a second
LIBRARIES = "numpy, scipy.linalg, scipy.interpolate, scipy.optimize, scipy.ndimage, av, pyapriltags, pyarrow.parquet"
LOAD = f"import {LIBRARIES}, sys\n"
DECODE = (
    LOAD
    + """
corners = numpy.load(sys.argv[2])
detect = pyapriltags.Detector(families=sys.argv[3], quad_decimate=1.0).detect
with av.open(sys.argv[1]) as film:
    film.streams.video[0].thread_type = "AUTO"
    for i, (frame, tags) in enumerate(zip(film.decode(video=0), corners)):
        plane = frame.planes[0]
        picture = numpy.frombuffer(plane, numpy.uint8).reshape(-1, plane.line_size)[: frame.height, : frame.width]
"""
)
WHOLE = "        if i % 10 == 0: detect(numpy.ascontiguousarray(picture))\n"
PARTS = """
        for tag in tags[numpy.isfinite(tags).all(axis=(1, 2))]:
            beside = 0.25 * numpy.ptp(tag, axis=0).max()
            ends = numpy.array([tag.min(axis=0) - beside, tag.max(axis=0) + beside])
            (x, y), (right, below) = ends.clip(0).astype(int)
            detect(numpy.ascontiguousarray(picture[y:below, x:right]))
"""
# What each does, and that of which it is more
FLOORS = {
    "NumPy, SciPy, PyAV, the tag detector and Arrow, loaded": (LOAD, ""),
    "Matplotlib, loaded (the report)": (f"{LOAD}import matplotlib.figure, matplotlib.backends.backend_agg", LOAD),
    "the film, decoded": (DECODE, LOAD),
    "the detector in a part around every tag": (DECODE + PARTS, DECODE),
    "the detector in every tenth whole picture": (DECODE + WHOLE, DECODE),
}
GOALS = {(): 6.0, ("--no-report",): 3.5}  # s of processor time, by the command's options


def learned(folder: Path, options: tuple[str, ...], installed: str) -> tuple[float, float]:
    """s of processor time and MB at the peak of one run that finds no tags kept; in `installed` it finds what belongs
    to the programs."""
    with tempfile.TemporaryDirectory() as place:
        words = ["-m", "onebend", "learn", str(folder), "-o", f"{place}/out", "--json", "--quiet", *options]
        return ran(words, installed, f"{place}/cache")


def ran(words: list[str], installed: str, cache: str) -> tuple[float, float]:
    """s of processor time, and MB at the peak, of Python with these words."""
    own = {
        "PYTHONPYCACHEPREFIX": f"{installed}/bytecode",
        "MPLCONFIGDIR": f"{installed}/fonts",
        "XDG_CACHE_HOME": cache,
    }
    environment = {**os.environ, **own}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    output = os.open(os.devnull, os.O_WRONLY)
    actions = [(os.POSIX_SPAWN_DUP2, output, 1)]
    process = os.posix_spawn(sys.executable, [sys.executable, *words], environment, file_actions=actions)
    _, status, used = os.wait4(process, 0)
    os.close(output)
    if status:
        raise RuntimeError(f"{' '.join(words)} ended with {os.waitstatus_to_exitcode(status)}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0


def floors(folder: Path, installed: str, repeats: int) -> dict[str, float]:
    """s of processor time, the least of some runs, of what the libraries do by themselves."""
    recording = read_recording(folder)
    assert recording.video is not None
    corners = Path(installed) / "corners.npy"
    np.save(corners, detect_tags(recording.video, recording.tags).corners)
    words = [str(recording.video.file), str(corners), recording.tags.family]
    scripts = {script for pair in FLOORS.values() for script in pair if script}
    spent = {
        script: min(ran(["-c", script, *words], installed, installed)[0] for _ in range(repeats + 1))
        for script in scripts
    }
    return {name: spent[script] - spent.get(less, 0.0) for name, (script, less) in FLOORS.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recording", type=Path, default=RECORDINGS / NAME)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    began, load = time.process_time(), os.getloadavg()[0]
    for i in range(3_000_000):  # how quick the machine is just now
        began += 0.0 * i
    loop = time.process_time() - began
    print(f"{arguments.recording.name}; load of the machine {load:.1f}, three million additions take {loop:.2f} s.\n")
    print("| command | processor time [s], median | least | goal | MB at the peak |\n" + "| --- " * 5 + "|")
    with tempfile.TemporaryDirectory() as installed:
        learned(arguments.recording, (), installed)
        for options, goal in GOALS.items():
            runs = [learned(arguments.recording, options, installed) for _ in range(arguments.repeats)]
            spent = [seconds for seconds, _ in runs]
            print(
                f"| `{' '.join(('learn', *options))}` | {statistics.median(spent):.1f} | {min(spent):.1f} | {goal:g} "
                f"| {max(mb for _, mb in runs):.0f} |",
                flush=True,
            )
        least = floors(arguments.recording, installed, arguments.repeats)
    print("\n| floor: the libraries by themselves | processor time [s], least |\n| --- | --- |")
    for name, seconds in least.items():
        print(f"| {name} | {seconds:.2f} |")


if __name__ == "__main__":
    main()
