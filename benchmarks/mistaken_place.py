"""The place of the push said wrongly, by 5 to 40 % of the length: seen, or in the band? And are right ones accused?

Every recording is a beam, bench and push drawn at random, every second with effects of a real bench, written as a
folder of marker tracks and learned by the public call. Of a bench with effects nothing is stated more exactly than a
`recording.toml` without a word on it says: what is stated and not so is another mistake. `outside`: trusted, with k(s)
out of the 95 % band on more than 10 % of the identified places. `accused`: in doubt for the place of the push; a
warning alone may be of millimetres. The camera sees the tool in films alone (`tool_place`); here nothing but the tags
and the force can tell.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.special import betaincinv

from onebend.errors import OnebendError
from onebend.lab.filming import recording_toml, write_log
from onebend.lab.random_bench import LABORATORY, BenchRanges, random_bench
from onebend.lab.virtual import VirtualBench, VirtualRecording, true_stiffness, virtual_recording
from onebend.learning.optimizer import DOUBTS
from onebend.learning.posterior import stiffness_of
from onebend.pipeline import Run, learn
from onebend.records import Array

ROOT = Path(__file__).parents[1]
S = np.linspace(0.02, 0.98, 49)
WAYS = ("at the tip, acts inside", "inside, acts at the tip", "elsewhere")  # said
LEAST, MOST = 0.05, 0.4  # of the length, that a place is wrong by
INNERMOST = 0.4  # where a push is said to act, or acts
MUCH = 0.1  # of the identified places outside the band
PLACE_DOUBTS = ("the stated place of the push (at_s) is wrong", DOUBTS["tool place"])


@dataclass(frozen=True)
class Outcome:
    """One recording learned, against its truth."""

    seed: int
    mistaken: bool
    acts_s: float
    said_s: float
    tags: int
    refused: str = ""
    doubts: tuple[str, ...] = ()
    about: tuple[str, ...] = ()  # of its warnings
    outside: float = 0.0  # share of the identified places where k is out of the band
    identified: float = 0.0  # share of the places
    half: float = 0.0  # median of the log of the band's upper end over k, identified places
    worst: float = 0.0  # largest |log k / truth| there
    seconds: float = 0.0

    @property
    def trusted(self) -> bool:
        return not self.refused and not self.doubts

    @property
    def silent(self) -> bool:
        """Trusted and wrong."""
        return self.trusted and self.outside > MUCH

    @property
    def accused(self) -> bool:
        """In doubt for the place of the push."""
        return bool(set(PLACE_DOUBTS) & set(self.doubts))

    @property
    def warned(self) -> bool:
        """Of a wrong place of the push, by any test."""
        return bool({"push place", "tool place"} & set(self.about))


def drawn(seed: int, mistaken: bool) -> VirtualBench:
    """A bench; with a mistake, `declared.push_s` is wrong."""
    rng = np.random.default_rng([seed, 4117])
    ranges = BenchRanges(effects=LABORATORY if seed % 2 else None)
    if not mistaken:
        return random_bench(rng, ranges).bench
    off, way = float(rng.uniform(LEAST, MOST)), WAYS[seed % len(WAYS)]
    if way == WAYS[0]:
        acts, said = 1.0 - off, 1.0
    elif way == WAYS[1]:
        acts, said = 1.0, 1.0 - off
    else:
        acts = float(rng.uniform(max(INNERMOST, LEAST), 1.0 - LEAST))
        able = [one for one in (acts - off, acts + off) if INNERMOST <= one <= 1.0]
        said = float(rng.choice(able)) if able else (1.0 if 1.0 - acts > acts - INNERMOST else INNERMOST)
    bench = random_bench(rng, replace(ranges, pushed_at=(round(acts, 3),))).bench
    return replace(bench, declared=replace(bench.declared, push_s=round(said, 3)))


def written(made: VirtualRecording, folder: Path) -> Path:
    """As a folder of tracks; base marker 0, with its angle."""
    folder.mkdir(parents=True, exist_ok=True)
    seen, rows = made.markers, ["time_s,id,x_m,y_m,angle_rad"]
    for t, when in enumerate(seen.time.tolist()):
        rows.append(f"{when:.5f},0,0,0,0")
        for i, tag in enumerate(seen.tag_id.tolist()):
            if np.isfinite(seen.xy[t, i]).all():
                rows.append(f"{when:.5f},{tag},{seen.xy[t, i, 0]:.7f},{seen.xy[t, i, 1]:.7f},{seen.angle[t, i]:.6f}")
    (folder / "markers.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    write_log(folder / "force.csv", made.log)
    clock = made.bench.clock
    tracks = f'[markers]\nfile = "markers.csv"\nstart_s = {clock.declared}\nstart_uncertainty_s = {clock.uncertainty}\n'
    text = recording_toml(replace(made.recording, folder=folder, video=None)) + "\n" + tracks
    (folder / "recording.toml").write_text(text, encoding="utf-8")
    return folder


def run(seed: int, mistaken: bool) -> Outcome:
    """Make, write, learn, compare."""
    bench = drawn(seed, mistaken)
    made, said = virtual_recording(bench, seed=seed), bench.declared.push_s
    before = Outcome(seed, mistaken, bench.push.at_s, bench.push.at_s if np.isnan(said) else said, len(bench.tags))
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        try:
            found = learn(written(made, Path(name) / "rec"))
        except OnebendError as wrong:
            return replace(before, refused=str(wrong), seconds=time.perf_counter() - began)
    return replace(
        compared(before, found, true_stiffness(bench, made.motion, S).k), seconds=time.perf_counter() - began
    )


def compared(before: Outcome, found: Run, truth: Array) -> Outcome:
    """What was learned, whatever the verdict, against k (49,) at S."""
    posterior = found.posterior
    assert posterior is not None
    band = stiffness_of(posterior.problem, posterior.optimum, posterior.gain_sd).band(S)
    known, away = band.identified, np.abs(np.log(band.k / truth))
    out = (truth < band.low) | (truth > band.high)
    remarks = [*found.remarks, *(one for seen in found.recordings for one in seen.source.remarks)]
    return replace(
        before,
        doubts=posterior.doubts,
        about=tuple(dict.fromkeys(one.about for one in remarks if one.level == "warning")),
        outside=float(np.mean(out[known])) if np.any(known) else 0.0,
        identified=float(np.mean(known)),
        half=float(np.median(np.log(band.high / band.k)[known])) if np.any(known) else 0.0,
        worst=float(np.max(away[known], initial=0.0)),
    )


def kept() -> Path:
    """The file that runs of this very code are added to."""
    digest = hashlib.sha256()
    for source in sorted([*(ROOT / "src").rglob("*.py"), Path(__file__)]):
        digest.update(source.read_bytes())
    return ROOT / "out" / "benchmarks" / f"mistaken-place-{digest.hexdigest()[:12]}.jsonl"


def study(wanted: Sequence[tuple[int, bool]], path: Path) -> list[Outcome]:
    """Do what `path` does not hold yet, and add it there."""
    done: dict[tuple[int, bool], Outcome] = {}
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            data = json.loads(line)
            one = Outcome(**(data | {"doubts": tuple(data["doubts"]), "about": tuple(data["about"])}))
            done[one.seed, one.mistaken] = one
    path.parent.mkdir(parents=True, exist_ok=True)
    todo = [one for one in wanted if one not in done]
    with path.open("a", encoding="utf-8") as lines:
        for count, (seed, mistaken) in enumerate(todo, 1):
            done[seed, mistaken] = one = run(seed, mistaken)
            lines.write(json.dumps(asdict(one)) + "\n")
            lines.flush()
            print(f"\r{count}/{len(todo)} ", end="", file=sys.stderr, flush=True)
    return [done[one] for one in wanted]


def counts(name: str, outcomes: Iterable[Outcome]) -> str:
    """The table's row of some recordings."""
    all_of = list(outcomes)
    refused = sum(bool(one.refused) for one in all_of)
    doubted = sum(not one.refused and not one.trusted for one in all_of)
    good = [one for one in all_of if one.trusted]
    silent, warned = [one for one in good if one.silent], [one for one in good if one.warned]
    known = [one for one in good if one.identified]
    half = np.median([one.half for one in known]) if known else np.nan
    places = np.average([one.outside for one in known], weights=[one.identified for one in known]) if known else np.nan
    return (
        f"| {name} | {len(all_of)} | {refused} | {doubted} | {len(warned)} | {len(good)} | {len(silent)} "
        f"({at_most(len(silent), len(all_of))}) | {100.0 * places:.0f} | {100.0 * np.expm1(half):.0f} |"
    )


def at_most(count: int, of: int) -> str:
    """The share that `count` of so many leave possible, at 95 % (Clopper and Pearson, one side)."""
    return f"at most {100.0 * (betaincinv(count + 1, of - count, 0.95) if count < of else 1.0):.0f} %"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mistakes", type=int, default=60)
    parser.add_argument("--right", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--kept", type=Path, help="file that the runs are added to; default: one a version of the code")
    asked = parser.parse_args()
    wrong = [(asked.first + i, True) for i in range(asked.mistakes)]
    right = [(asked.first + i, False) for i in range(asked.right)]
    both = sorted([*wrong, *right])  # in turn, so that a run that is cut short tells of both
    show(study(both, asked.kept or kept()))


def show(done: Sequence[Outcome]) -> None:
    """The table, and the recordings that went wrong."""
    print(
        "| the place | recordings | refused | in doubt | trusted, with a warning of it | trusted | of them outside "
        "the band (share of all, at 95 %) | identified places outside, trusted [%] | half-width of the band, trusted "
        "[%] |"
    )
    print("| --- " * 9 + "|")
    for i, way in enumerate(WAYS):
        print(counts(f"said {way}", (one for one in done if one.mistaken and one.seed % len(WAYS) == i)))
    right = [one for one in done if not one.mistaken]
    print(counts("all mistakes", (one for one in done if one.mistaken)))
    print(counts("said rightly, ideal benches", (one for one in right if not one.seed % 2)))
    print(counts("said rightly, real benches", (one for one in right if one.seed % 2)))
    accused = sum(one.accused for one in right)
    print(f"\nRight places accused: {accused} of {len(right)} ({at_most(accused, len(right))} of all, at 95 %).")
    print("\nSilently wrong, and rightly said but refused, in doubt, warned of or outside the band:\n")
    for one in done:
        if (one.mistaken and one.silent) or (not one.mistaken and (one.warned or not one.trusted or one.silent)):
            print(
                f"- {'mistake' if one.mistaken else 'right'} {one.seed}: acts {one.acts_s:g}, said {one.said_s:g}, "
                f"{one.tags} tags, {100 * one.outside:.0f} % outside, k off by {np.exp(one.worst):.2g} times at worst"
                f"{'; ' if one.refused or one.doubts else ''}{one.refused or ', '.join(one.doubts)}"
            )


if __name__ == "__main__":
    main()
