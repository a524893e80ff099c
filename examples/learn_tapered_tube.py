"""Learn the modulus of a tube whose diameters were measured, from weights hung on it and a ruler."""

from pathlib import Path

import onebend

run = onebend.learn(Path(__file__).parent / "tapered-tube")
modulus, low, high = (value / 1e9 for value in run.one_modulus())
print(f"E = {modulus:.1f} GPa, 95 % band {low:.1f} to {high:.1f} GPa")
band = run.posterior.band([0.1, 0.49, 0.51, 0.9])
print("k at s = 0.1, 0.49, 0.51 and 0.9 [N m]:", band.k.round(2))
