"""k(s) from films and marker tracks of benches that do what real ones do, by an independent simulator.

Shares are of places s from 0.05 to 0.9 of the push's place; k is the truth's, tags and relaxation included. A robot's
gain is taken as 2 % uncertain where nothing better is stated.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.truth import recordings_asked
from onebend.learning.attribution import FORCE_SCALE
from onebend.learning.posterior import Posterior, fit
from onebend.recording.observe import observe
from onebend.records import GAIN_SD, Array

IDEAL = tuple(f"{beam}_{push}" for beam in ("linear", "quadratic", "cubic") for push in ("train", "fast", "s08", "s06"))
PLACES = 60
LEVELS = (0.5, 0.95)
# What stands for the one effect of a recording that has no other, by its name in the truth or in the folder's name.
SINGLES = {
    "soft": ("stretch and shear",),
    "relax": ("relaxation",),
    "slide": ("sliding contact",),
    "push": ("place of the push",),
    "patch": ("stiff tags",),
    "force": (FORCE_SCALE, "posture-dependent bias"),
    "length": ("length",),
    "droop": ("camera",),  # the heights of the tags
    "phone": ("camera",),
    "shake": ("camera",),
}


@dataclass(frozen=True)
class Found:
    """One fit against its truth; shares of PLACES."""

    name: str
    named: tuple[str, ...]  # what matters, as the verdict has it
    true_place: int  # among those, of a recording's only effect; 0: not named, -1: it has none or several
    error: float  # RMS of k / truth - 1
    inside: tuple[float, ...]  # of the bands of LEVELS
    identified: float
    half_width: float  # of the 95 % band, in log k, median
    steps: int
    converged: bool
    grade: str
    seconds: float  # processor time of the fit


def learned(folder: Path) -> Found:
    """Observe, fit, compare."""
    seen = observe(folder)
    began = time.process_time()
    posterior = fit([seen], gain_sd=max(seen.stated.gain_sd, GAIN_SD))
    seconds = time.process_time() - began
    truth = np.load(folder / "truth" / "truth.npz")
    s = np.linspace(0.05, 0.9 * float(np.nanmedian(seen.push_s)), PLACES)
    return _compared(folder, posterior, s, np.interp(s, truth["s"], truth["k"]), seconds)


def _compared(folder: Path, posterior: Posterior, s: Array, k: Array, seconds: float) -> Found:
    bands = [posterior.band(s, level) for level in LEVELS]
    wide = bands[-1]
    named = tuple(a.name for a in posterior.attributions if a.matters)
    return Found(
        name=folder.name,
        named=named,
        true_place=true_place(folder, named),
        error=float(np.sqrt(np.mean((wide.k / k - 1.0) ** 2))),
        inside=tuple(float(np.mean((b.low <= k) & (k <= b.high))) for b in bands),
        identified=float(np.mean(wide.identified)),
        half_width=float(np.median(np.log(wide.high / wide.low)) / 2.0),
        steps=posterior.optimum.steps,
        converged=posterior.optimum.converged,
        grade=posterior.grade,
        seconds=seconds,
    )


def true_place(folder: Path, named: Sequence[str]) -> int:
    """Where among the `named`, from 1 on, the only effect of a recording stands; see `Found`."""
    truth = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))
    names = SINGLES.get(truth.get("effect", folder.name.split("_")[-1]))
    if names is None:
        return -1
    return next((i for i, name in enumerate(named, start=1) if name in names), 0)


def row(one: Found) -> str:
    """Of the table."""
    inside = " / ".join(f"{100.0 * share:.0f}" for share in one.inside)
    ended = str(one.steps) if one.converged else f"{one.steps}, not converged"
    place = {-1: "-", 0: "no"}.get(one.true_place, str(one.true_place))
    verdict = f"{one.grade}: {', '.join(one.named) or 'none'}"
    return (
        f"| {one.name} | {100.0 * one.error:.1f} | {inside} | {100.0 * one.identified:.0f} "
        f"| {100.0 * one.half_width:.0f} | {verdict} | {place} | {ended} | {one.seconds:.1f} |"
    )


def summary(name: str, every: list[Found]) -> str:
    """Means, and the middle run's error."""
    inside = 100.0 * np.mean([one.inside for one in every], axis=0)
    known = 100.0 * float(np.mean([one.identified for one in every]))
    width = 100.0 * float(np.median([one.half_width for one in every]))
    error = 100.0 * float(np.median([one.error for one in every]))
    shares = " / ".join(f"{share:.0f}" for share in inside)
    ended = sum(one.converged for one in every)
    places = [one.true_place for one in every if one.true_place >= 0]
    first = f"{sum(0 < place <= 2 for place in places)} of {len(places)} among the first two" if places else ""
    return (
        f"| **{name}, {len(every)}** | {error:.1f} | {shares} | {known:.0f} | {width:.0f} | | {first} "
        f"| {ended} converged | |"
    )


def main() -> None:
    recordings = recordings_asked(__doc__)
    head = "| recording | k off, RMS [%] | truth inside 50 / 95 % band [%] | identified [%] "
    print(head + "| half-width of the 95 % band [%] | grade: what matters | place of the one true effect ", end="")
    print("| steps | fit, processor time [s] |")
    print("| --- |" + " --- |" * 8)
    groups: dict[str, list[Found]] = {}
    ideal = [one for one in recordings.iterdir() if one.name in IDEAL]
    for folder in [
        *sorted(ideal),
        *sorted((recordings / "wild").iterdir()),
        *sorted((recordings / "tracks").iterdir()),
    ]:
        if not (folder / "truth" / "truth.npz").is_file():
            continue
        print(folder.name, file=sys.stderr, flush=True)
        one = learned(folder)
        print(row(one), flush=True)
        kind = "films" if folder.parent.name == "wild" else f"tracks, {folder.name.split('_')[0]}"
        kind = "films, ideal benches" if folder in ideal else kind
        groups.setdefault(kind, []).append(one)
    for name, every in groups.items():
        print(summary(name, every))


if __name__ == "__main__":
    main()
