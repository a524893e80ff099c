"""Damping and k over mass from a release: the development recording's free swing against its truth.

    python -m benchmarks.motion        # about three minutes

The recording was made by a chain of hinges with damping in proportion to stiffness. The model is learned from another
recording of the same beam (a slow push); the mass is known as a whole (weighed), or not at all.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.truth import RECORDINGS, Truth, read_truth
from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.stiffness import Table, UncertainStiffness, Uniform
from onebend.beam.vibration import vibration
from onebend.learning.swing import DampingSettings, FilmPart, SwingFit, learn_damping
from onebend.pipeline import learn
from onebend.recording.folder import read_recording
from onebend.recording.observe import observe
from onebend.records import Observations

FREE = "quadratic_free"
PUSH = "quadratic_train"


def true_beam(truth: Truth) -> Beam:
    """With its own k(s) and mass."""
    mass = np.load(RECORDINGS / FREE / "truth" / "truth.npz")["rhoA"]
    places = tuple(truth.s.tolist())
    return Beam(
        float(truth.facts["L"]),
        Table(places, tuple(truth.k.tolist())),
        mass_per_length=Table(places, tuple(mass.tolist())),
    )


def row(name: str, fit: SwingFit, tau: float, frequency: float, mass: float) -> str:
    one = fit.damping
    cells = [
        name,
        f"{1e3 * one.loss_time:.3f} ({1e3 * one.loss_time_sd:.3f})",
        f"{100 * (one.loss_time / tau - 1):+.2f} %",
        f"{one.frequency[0]:.4f} ({one.frequency_sd:.4f})",
        f"{100 * (one.frequency[0] / frequency - 1):+.2f} %",
        f"{fit.factor:.3f} ({np.hypot(fit.factor_sd, fit.model_sd):.3f})" if fit.mass_known else "",
        ""
        if fit.mass_known
        else f"{1e3 * fit.mass:.1f} ({1e3 * fit.mass_sd:.1f}), {100 * (fit.mass / mass - 1):+.1f} %",
        ", ".join(f"{1e3 * value:.2f}" for value in fit.rms),
    ]
    return "| " + " | ".join(cells) + " |"


def rows(seen: Observations, learned: Beam, band: UncertainStiffness, true: Beam) -> Iterator[tuple[str, SwingFit]]:
    """Every way to ask."""
    bare, width = replace(learned, mass_per_length=Uniform(0.0)), DampingSettings(mass_along="width")
    unweighed = replace(seen, stated=replace(seen.stated, mass=float("nan")))
    yield "learned k, weighed, mass as the width", learn_damping(bare, seen, uncertain=band, settings=width)
    yield "the same, mass even", learn_damping(bare, seen, uncertain=band)
    yield "as the width, not weighed", learn_damping(bare, unweighed, uncertain=band, settings=width)
    for begin in (3.6, 4.5):
        fit = learn_damping(bare, seen, uncertain=band, part=FilmPart(begin), settings=width)
        yield f"as the width, from {begin:.1f} s of the film", fit
    yield "true k and mass", learn_damping(true, seen)


def main() -> None:
    truth = read_truth(RECORDINGS / FREE)
    true, tau = true_beam(truth), float(truth.facts["eta"])
    frequency = float(vibration(true, equilibrium(true, push([[0.0, 0.0]])), count=1).frequency[0])
    run = learn(RECORDINGS / PUSH)
    assert run.posterior is not None
    seen = observe(read_recording(RECORDINGS / FREE))
    print(
        f"True: loss time {1e3 * tau:.3f} ms, natural frequency {frequency:.4f} Hz, mass "
        f"{1e3 * float(truth.facts['mass']):.1f} g. In brackets one sd. c: k over mass as it swings over the model's.\n"
    )
    print("| model | loss time [ms] | error | frequency [Hz] | error | c | mass [g] | tags off the model's mode [mm] |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for name, fit in rows(seen, run.posterior.beam, run.posterior.stiffness, true):
        print(row(name, fit, tau, frequency, float(truth.facts["mass"])), flush=True)


if __name__ == "__main__":
    main()
