"""Validation: the learned beam on pushes it never saw, under the true forces and under the logged ones.

With the logged forces the sensor's own error counts too: what the TRUE k gives on the same log stands beside it. And
under the true forces stands beside what the band of the fit says that the error is likely to be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.truth import RECORDINGS, Truth, read_truth, recordings_asked
from onebend.beam.model import Beam
from onebend.beam.stiffness import Table
from onebend.learning.frames import marker_rms
from onebend.learning.paper import RegressionSettings, regress
from onebend.learning.posterior import Posterior, fit
from onebend.learning.validation import validate
from onebend.recording.observe import observe
from onebend.records import Array, Observations

BEAMS = ("linear", "quadratic", "cubic")
KINDS = ("train", "fast", "s08", "s06")
LEARNED_FROM = (("train",), ("train", "s08", "s06"))
DRAWS = 12  # of k(s) from the posterior


@dataclass(frozen=True)
class Row:
    """One learned beam on one recording; every array is M1, M2, M3 ... in m."""

    beam: str
    learned_from: str
    recording: str
    true_forces: Array
    stated: Array  # one sd by the band of k(s)
    true_k_true_forces: Array  # what is left with nothing wrong but the tags and, in motion, the statics
    logged: Array
    true_k_logged: Array
    paper: Array  # the paper's regression, from the training push, under the logged forces

    @property
    def ratio(self) -> float:
        """Error with the logged forces over that of the true k on the same log, all markers together."""
        return float(np.linalg.norm(self.logged) / np.linalg.norm(self.true_k_logged))


def rows(recordings: Path = RECORDINGS) -> list[Row]:
    """Every beam, learned from one push and from three, on each of its pushes."""
    out: list[Row] = []
    for name in BEAMS:
        seen = {kind: observe(recordings / f"{name}_{kind}") for kind in KINDS}
        truth = {kind: read_truth(recordings / f"{name}_{kind}") for kind in KINDS}
        paper = regress(seen["train"], RegressionSettings(method="paper")).beam
        for kinds in LEARNED_FROM:
            found = fit([seen[kind] for kind in kinds], regress(seen["train"]).beam.stiffness)
            out += [row(name, " + ".join(kinds), found, paper, seen[kind], truth[kind], kind) for kind in KINDS]
    return out


def row(name: str, of: str, found: Posterior, paper: Beam, seen: Observations, truth: Truth, kind: str) -> Row:
    """The learned beam, the true one and the paper's on one recording."""
    beam = found.beam
    exact = replace(beam, stiffness=Table(tuple(truth.s), tuple(truth.k)))
    forced = replace(seen, force=truth.force[seen.frame])
    here = validate(beam, forced)
    others = [validate(replace(beam, stiffness=k), forced) for k in found.stiffness.draw(DRAWS, seed=0)]
    return Row(
        beam=name,
        learned_from=of,
        recording=kind,
        true_forces=here.rms,
        stated=np.sqrt(np.mean([marker_rms(one.predicted - here.predicted) ** 2 for one in others], axis=0)),
        true_k_true_forces=validate(exact, forced).rms,
        logged=validate(beam, seen).rms,
        true_k_logged=validate(exact, seen).rms,
        paper=validate(paper, seen).rms,
    )


def main() -> None:
    found = rows(recordings_asked(__doc__))
    print("M1, M2, M3 in mm, RMS. `true k`: the same with the true stiffness in place of the learned one.\n")
    heads = (
        "beam | learned from | on | true forces | (one sd by the band) | (true k) | logged forces | (true k) | ratio"
    )
    print(f"| {heads} | the paper's |")
    print("| --- " * 10 + "|")
    for r in found:
        cells = [", ".join(f"{1e3 * v:.2f}" for v in one) for one in (r.true_forces, r.stated, r.true_k_true_forces)]
        logged = [", ".join(f"{1e3 * v:.2f}" for v in one) for one in (r.logged, r.true_k_logged)]
        paper = ", ".join(f"{1e3 * v:.2f}" for v in r.paper)
        print(
            f"| {r.beam} | {r.learned_from} | {r.recording} | {' | '.join(cells)} | {' | '.join(logged)} "
            f"| {r.ratio:.2f} | {paper} |"
        )


if __name__ == "__main__":
    main()
