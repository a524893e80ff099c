"""Mass learned beside k(s): the development beam under gravity, its mass not told

`total` is the beam's mass, `pull` the evenly heavy beam's with the same moment about the clamp: mass near the clamp
bends nothing, so the second is what the recordings see. The bench's description says that the beam is 30 mm deep
everywhere and that its width varies: `mass_along = "width"` states that, and then one number is learned.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from benchmarks.truth import RECORDINGS
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import fit
from onebend.learning.start import start_of, with_mass
from onebend.recording.observe import observe
from onebend.records import MassAlong

SETS = (("grav", "gravpush"), ("train", "grav", "gravpush"))
STATED: tuple[MassAlong, ...] = ("unknown", "width")
SETTINGS = FitSettings(most_frames=150, first_frames=60)


def main() -> None:
    names = sorted({name for names in SETS for name in names})
    weighed = {name: observe(RECORDINGS / f"quadratic_{name}") for name in names}
    seen = {name: replace(o, stated=replace(o.stated, mass=np.nan)) for name, o in weighed.items()}
    truth = np.load(RECORDINGS / "quadratic_train" / "truth" / "truth.npz")
    s, line, length = truth["s"], truth["rhoA"], seen["grav"].length
    total, pull = length * np.trapezoid(line, s), 2 * length * np.trapezoid(s * line, s)
    print("The bench's description says that the beam is 30 mm deep everywhere and that its width varies:")
    print('`mass_along = "width"` states that.\n')
    print("| learned from | stated | total [g] (true) | off [%] | pull [g] (true) | off [%] | k(s) off, RMS [%] |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    inside = (s >= 0.05) & (s <= 0.9)
    for chosen, along in product(SETS, STATED):
        ready = with_mass([replace(seen[name], stated=replace(seen[name].stated, mass_along=along)) for name in chosen])
        posterior = fit(ready, start_of(ready, None), settings=SETTINGS)
        mass = posterior.mass
        assert mass is not None
        away = (posterior.beam.stiffness(s) / truth["k"] - 1)[inside]
        print(
            f"| {' + '.join(chosen)} | {along} | {1e3 * mass.value:.1f} +- {1e3 * mass.sd:.1f} ({1e3 * total:.1f}) | "
            f"{100 * (mass.value / total - 1):+.1f} | {1e3 * mass.even:.1f} +- {1e3 * mass.even_sd:.1f} "
            f"({1e3 * pull:.1f}) | {100 * (mass.even / pull - 1):+.1f} | {100 * np.sqrt(np.mean(away**2)):.1f} |"
        )


if __name__ == "__main__":
    main()
