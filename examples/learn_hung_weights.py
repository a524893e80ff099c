"""Learn a rod from weights hung on it and a table of where its points went: no film, no force log, no clock."""

from pathlib import Path

import onebend

HERE = Path(__file__).parent / "hung-weights"

run = onebend.learn(HERE)
band = run.posterior.band([0.1, 0.35, 0.6])
print("k at s = 0.1, 0.35 and 0.6 [N m]:", band.k.round(2))
print("95 % band, from:", band.low.round(2), "to:", band.high.round(2))
