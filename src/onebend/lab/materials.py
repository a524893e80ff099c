"""Young's modulus of castable silicones: from a hardness, or from what the maker measured.

Neither is a measurement of the batch in the mould. Each way states how far off it is likely to be, as one standard
deviation of log E, from its scatter against the makers' figures listed here and from the usual tolerance of a hardness.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass

from onebend.errors import MechanicsError

PSI = 6894.757  # Pa
HARDNESS_SD = 2.5  # points; makers allow +-5
GENT_FIT, HERTZ_FIT, STRESS_FIT = 0.25, 0.5, 0.2  # sd of log E of the three relations where they hold
GENT_RANGE, SHORE_A_RANGE, SHORE_00_RANGE = (20.0, 80.0), (5.0, 95.0), (5.0, 95.0)
BEYOND_GENT = 0.5  # sd of log E outside GENT_RANGE
TYPICAL_DENSITY = 1080.0  # kg/m^3 of unfilled castable silicone
BALL_RADIUS, TRAVEL = 1.19e-3, 2.54e-3  # m, the indenter of type 00 and its way (ASTM D2240)


@dataclass(frozen=True)
class ModulusEstimate:
    """A modulus and how sure it is."""

    modulus: float  # E at small strain, Pa
    log_sd: float  # sd of log E
    source: str  # one line: where it comes from


@dataclass(frozen=True)
class Silicone:
    """A product, by its maker's data sheet."""

    name: str
    shore: float
    scale: str  # "A" or "00"
    stress_100: float  # Pa, stress over first area at 100 % stretch; NaN where the maker gives none
    density: float  # kg/m^3
    maker: str

    @property
    def stiffness(self) -> ModulusEstimate:
        """E from the stress at 100 % stretch where the maker gives it, else from the hardness."""
        if math.isfinite(self.stress_100):
            return from_stress_100(self.stress_100, f"{self.name}, stress at 100 % stretch by {self.maker}")
        by = from_shore_a if self.scale == "A" else from_shore_00
        estimate = by(self.shore)
        return ModulusEstimate(estimate.modulus, estimate.log_sd, f"{self.name}: {estimate.source}")


def _silicone(name: str, shore: float, scale: str, psi: float, density: float, maker: str = "Smooth-On") -> Silicone:
    return Silicone(name, shore, scale, psi * PSI, density, maker)


# Makers' technical bulletins: hardness, "100 % modulus" [psi], specific gravity.
SILICONES = {
    silicone.name: silicone
    for silicone in (
        _silicone("Ecoflex 00-10", 10.0, "00", 8.0, 1040.0),
        _silicone("Ecoflex 00-20", 20.0, "00", 8.0, 1070.0),
        _silicone("Ecoflex 00-30", 30.0, "00", 10.0, 1070.0),
        _silicone("Ecoflex 00-50", 50.0, "00", 12.0, 1070.0),
        _silicone("Dragon Skin 10", 10.0, "A", 22.0, 1070.0),
        _silicone("Dragon Skin 20", 20.0, "A", 49.0, 1080.0),
        _silicone("Dragon Skin 30", 30.0, "A", 86.0, 1080.0),
        _silicone("Elastosil M 4601", 28.0, "A", math.nan, 1130.0, "Wacker"),
        _silicone("Sylgard 184", 43.0, "A", math.nan, 1030.0, "Dow"),
    )
}


def silicone(name: str) -> Silicone:
    """A named silicone, whatever the case of the letters. Raises `MechanicsError` on an unknown one."""
    known = {each.lower(): each for each in SILICONES}
    if name.lower() not in known:
        near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.4)
        hint = f"Did you mean {known[near[0]]!r}? " if near else ""
        raise MechanicsError(
            f"no data of a silicone named {name!r}. {hint}Known: {', '.join(SILICONES)}. "
            "For another give its Shore hardness or its modulus."
        )
    return SILICONES[known[name.lower()]]


def from_shore_a(shore: float) -> ModulusEstimate:
    """E from a Shore A hardness: A. N. Gent, Rubber Chem. Technol. 31 (1958) 896, a rigid flat punch on a half-space.

    Its derivation holds from 20 to 80; it is taken from 5 to 95 with a wider band.

    Raises:
        MechanicsError: a hardness outside 5 to 95.
    """
    _check(shore, SHORE_A_RANGE, "A")
    modulus = 0.0981e6 * (56.0 + 7.62336 * shore) / (0.137505 * (254.0 - 2.54 * shore))
    per_point = 7.62336 / (56.0 + 7.62336 * shore) + 1.0 / (100.0 - shore)
    fit = GENT_FIT if GENT_RANGE[0] <= shore <= GENT_RANGE[1] else BEYOND_GENT
    return ModulusEstimate(modulus, math.hypot(fit, per_point * HARDNESS_SD), f"Shore A {shore:g} by Gent (1958)")


def from_shore_00(shore: float) -> ModulusEstimate:
    """E from a Shore 00 hardness: Hertz (1882), the ball and spring of ASTM D2240 on an incompressible half-space.

    The ball sinks in by more than Hertz's small depth, so that this is good to a factor of about 1.6 only.

    Raises:
        MechanicsError: a hardness outside 5 to 95.
    """
    _check(shore, SHORE_00_RANGE, "00")
    force, depth = 0.203 + 0.00908 * shore, TRAVEL * (1.0 - shore / 100.0)
    modulus = force / (16.0 / 9.0 * math.sqrt(BALL_RADIUS) * depth**1.5)
    per_point = 0.00908 / force + 1.5 / (100.0 - shore)
    return ModulusEstimate(
        modulus, math.hypot(HERTZ_FIT, per_point * HARDNESS_SD), f"Shore 00-{shore:g} by Hertz and ASTM D2240"
    )


def from_stress_100(stress: float, source: str = "stress at 100 % stretch") -> ModulusEstimate:
    """E at small strain from the nominal stress at 100 % stretch ("100 % modulus") [Pa] of a neo-Hookean rubber.

    `stress = E / 3 (stretch - stretch^-2)` at stretch 2, hence E = 12/7 of it (Treloar 1975).

    Raises:
        MechanicsError: a stress that is not positive.
    """
    if not (math.isfinite(stress) and stress > 0.0):
        raise MechanicsError(f"a stress at 100 % stretch must be positive, got {stress} Pa")
    return ModulusEstimate(12.0 / 7.0 * stress, STRESS_FIT, source)


def _check(shore: float, allowed: tuple[float, float], scale: str) -> None:
    if not allowed[0] <= shore <= allowed[1]:
        raise MechanicsError(
            f"Shore {scale} {shore:g}: the relation to a modulus holds from {allowed[0]:g} to {allowed[1]:g}. "
            "Give the modulus, or the hardness on the scale that fits"
        )
