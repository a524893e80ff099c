"""Learn a beam from one filmed push, check it on another push, and ask it where a force would take its tip."""

from pathlib import Path

import onebend

HERE = Path(__file__).parent / "linear-beam"

observations = onebend.observe(HERE / "train")  # files --> markers [m] and forces [N] on one clock
found = onebend.fit([observations])  # --> k(s) with a band, in the space of the markers

band = found.band([0.0, 0.5, 1.0])
print("k at base, middle and tip [N m]:", band.k.round(4))
print("95 % band, from:", band.low.round(4), "to:", band.high.round(4), "identified:", band.identified)

beam = found.beam
check = onebend.validate(beam, onebend.observe(HERE / "fast"))
print("RMS of the three markers on the fast push [mm]:", (1000 * check.rms).round(2))

shape = beam.equilibrium(force=(0.0, 0.2), at_s=1.0)  # a push of 0.2 N across the tip
print("the tip would go to [mm]:", (1000 * shape.xy(1.0)).round(1))
