"""Virtual recordings for studies of the marker-space fit: kinds of beams, kinds of errors, one run each.

The truths are not drawn from the fit's own prior, and the errors are made by the virtual lab.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid

from benchmarks.in_family import ALLOWED, draw, least_variance, thirds
from onebend.beam.grid import powers_to_legendre
from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Profile
from onebend.errors import LearningError, MechanicsError, ObservationError
from onebend.lab.bench import FRANKA, ForceSensor, PushProfile, TagNoise
from onebend.lab.designs import Kind, force_that_bends, random_stiffness
from onebend.lab.virtual import (
    DeclaredValues,
    VirtualBench,
    VirtualClock,
    VirtualTag,
    observe_virtual,
    virtual_recording,
)
from onebend.learning.fit_data import REST_MODES
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import Posterior, fit
from onebend.recording.beam_frame import MOUNTING_SD
from onebend.records import CLAMP_SD as HELD_SD, CURVATURE_SD, DIRECTION_SD, TURN_SD, Array, Observations

KINDS: tuple[Kind, ...] = ("smooth", "stepped", "joint")
ERRORS = ("white", "correlated", "bias", "gain", "clock", "tags", "everything", "stages", "franka")
OWN = ("drawn scales", "drawn allowances", "fixed 6")  # drawn from the fit's own model: see `own_run`
LENGTH = 0.15  # m
PLACEMENT = 5e-4  # m, one sd, as stated
PLACED = 2e-5  # m, one sd as stated where the tags sit in their places: a jig's, not an exact zero
MOUNTING = TURN_SD  # rad, one sd of a tag's turn
CLAMP_SD = float(np.hypot(HELD_SD, MOUNTING_SD))  # rad, of the clamp's direction where the rest is unknown
PUSHED_SD = 5e-4  # m, of a push at a mark, as it is stated
PUSHED = 0.98  # where the push is said to act: off it either way there is beam
STRAIGHT = Powers((0.0,))
GAIN = 0.05  # one sd, as stated
REVERSAL = {"everything": 0.02, "stages": 0.1, "franka": 0.3}  # of the largest force
S = np.linspace(0.05, 0.9, 35)
LEVELS = (0.5, 0.8, 0.95)


@dataclass(frozen=True)
class Run:
    """One fit against its truth, at the places S."""

    cell: str
    seed: int
    failure: str = ""
    error: tuple[float, ...] = ()  # of log k
    sd: tuple[float, ...] = ()  # of log k, half the width of the 68 % band
    inside: tuple[tuple[bool, ...], ...] = ()  # of the bands of LEVELS
    identified: tuple[bool, ...] = ()
    clock_error: float = 0.0  # s
    clock_sd: float = 0.0  # s
    converged: bool = False
    thirds_error: tuple[float, ...] = ()  # of the means of log k over thirds, where drawn from the fit's own model
    thirds_variance: tuple[float, ...] = ()  # the least possible one
    seconds: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """For JSON, numbers to five digits."""
        out = asdict(self)
        out["error"], out["sd"] = ([float(f"{v:.5g}") for v in values] for values in (self.error, self.sd))
        out["inside"] = ["".join("01"[v] for v in row) for row in self.inside]
        out["identified"] = "".join("01"[v] for v in self.identified)
        return out

    @staticmethod
    def from_dict(data: dict[str, Any]) -> Run:
        """From `as_dict`."""
        changed = {
            "thirds_error": tuple(data.get("thirds_error", ())),
            "thirds_variance": tuple(data.get("thirds_variance", ())),
            "error": tuple(data["error"]),
            "sd": tuple(data["sd"]),
            "inside": tuple(tuple(v == "1" for v in row) for row in data["inside"]),
            "identified": tuple(v == "1" for v in data["identified"]),
        }
        return Run(**(data | changed))


def bench_of(kind: Kind, errors: str, seed: int) -> VirtualBench:
    """A random beam and push with one kind of errors; sizes of force errors are in parts of the largest force.

    Whatever the fit is told to allow for is drawn as it is told: where tags sit and how they are turned, the base tag,
    the place of the push, the axes of the force. white: force samples 2 %, tags 0.02 mm and 1 mrad a frame, placed to
    0.02 mm. correlated: also 3 % with a correlation time of 0.3 s. To that each of the next adds one thing: bias 30 %;
    gain 5 %; a written start of the film that is up to 1.5 s off; tags placed by hand, to 0.5 mm. everything: all of
    these, and noise of the tags that lasts, is stated too small and holds outliers, a force error of 2 % that changes
    when the load reverses, and a natural curvature. stages: beside the correlated errors one of 10 % that is drawn anew
    when the load begins and reverses. franka: the same of 30 %, a lag of 35 ms, a gain of 13 %, 80 samples a second,
    and a written start of the film as under clock.
    """
    rng = np.random.default_rng([seed, KINDS.index(kind), 7])
    everything = errors == "everything"

    def has(name: str) -> bool:
        return everything or errors == name

    placement = PLACEMENT if has("tags") else PLACED
    beam = Beam(LENGTH, random_stiffness(kind, rng), rest_curvature=rest_curvature(rng) if everything else STRAIGHT)
    direction, turn = rng.uniform(1.4, 2.1), rng.uniform(0.2, 0.8)
    at_s = PUSHED + PUSHED_SD / LENGTH * float(rng.standard_normal())
    peak = force_that_bends(beam, rng.uniform(0.7, 1.3), direction, at_s)
    off = rng.standard_normal((3, 3)) * np.array([placement, placement, MOUNTING])
    base = rng.standard_normal(3) * np.array([placement, placement, MOUNTING_SD])
    lasting = TagNoise(slow_xy=1e-5, slow_angle=5e-4, stated=0.7, outliers=0.005, missing=0.01)
    franka = errors == "franka"
    gain = GAIN * has("gain") + FRANKA.gain_sd * franka
    bias = 0.3 * peak * rng.standard_normal(2) * has("bias")
    late = has("clock") or franka
    return VirtualBench(
        beam=beam,
        push=PushProfile(peak, direction=direction, turn=turn, at_s=at_s),
        tags=tuple(VirtualTag(i + 1, (i + 1) / 3, *map(float, off[i])) for i in range(3)),
        base=(float(base[0]), float(base[1]), float(base[2])),
        sensor=sensor_of(errors, peak, bias, gain),
        camera=lasting if everything else TagNoise(),
        clock=VirtualClock(250.0, 250.0 + rng.uniform(-1.5, 1.5), 2.0) if late else VirtualClock(250.0, 250.0, 0.01),
        declared=DeclaredValues(
            push_s=PUSHED,
            placement_sd=placement,
            place_sd=PUSHED_SD,
            axes=DIRECTION_SD * float(rng.standard_normal()),
            rest="unknown" if everything else "straight",
            gain_sd=gain,
        ),
        name=f"{kind} {errors} {seed}",
    )


def sensor_of(errors: str, peak: float, bias: Array, gain: float) -> ForceSensor:
    """The sensor of one kind of errors, for pushes of `peak` [N]; `bias` (2,) [N], sd `gain` of its scale."""
    franka = errors == "franka"
    return ForceSensor(
        white_sd=0.02 * peak,
        coloured_sd=0.0 if errors == "white" else 0.03 * peak,
        bias=(float(bias[0]), float(bias[1])),
        gain_sd=gain,
        reversal=REVERSAL.get(errors, 0.0) * peak,
        lag=FRANKA.lag * franka,
        rate=FRANKA.rate if franka else 200.0,
    )


def rest_curvature(rng: np.random.Generator) -> Profile:
    """A natural curvature as the fit expects it, given that the tags at rest lie on the frame's x axis.

    The fit takes its three Legendre states and the clamp's direction from priors of their own. The frame is turned so
    that the line through the tags is its x axis: so the clamp's direction undoes what the curvature turns that line by.
    """
    s = np.linspace(0.0, 1.0, 601)
    height = cumulative_trapezoid(REST_MODES.angle(s), s, axis=0, initial=0.0)[200::200]
    line = s[200::200] @ height / np.sum(s[200::200] ** 2)
    precision = np.eye(3) / CURVATURE_SD**2 + np.outer(line, line) / CLAMP_SD**2
    states = np.linalg.cholesky(np.linalg.inv(precision)) @ rng.standard_normal(3)
    return Powers(tuple(np.linalg.solve(powers_to_legendre(3), states).tolist()))


def run(cell: str, seed: int) -> Run:
    """Make, observe, fit, compare. A cell is a kind of beam and a kind of errors, as "smooth white", or OWN."""
    kind, errors = cell.split()
    if cell in OWN:
        return own_run(cell, seed)
    began = time.perf_counter()
    try:
        bench = bench_of(kind, errors, seed)  # type: ignore[arg-type]
        seen = observe_virtual(virtual_recording(bench, seed=seed))
        found = fit_from_nothing(seen, gain_sd=bench.declared.gain_sd)
    except (LearningError, MechanicsError, ObservationError) as wrong:
        return Run(cell, seed, failure=f"{type(wrong).__name__}: {wrong}")
    assert seen.source.clock is not None
    return replace(
        compared(found, np.asarray(bench.beam.stiffness(S)), cell, seed),
        clock_error=seen.source.clock.offset - bench.clock.offset - bench.sensor.lag,  # a lag is part of the offset
        clock_sd=seen.source.clock.sd,
        seconds=time.perf_counter() - began,
    )


def own_run(cell: str, seed: int) -> Run:
    """The same with a draw from the fit's own model: "drawn scales" draws all that the fit does not know from the
    priors that it has of it, the sizes in the prior of log k included: its band must hold the truth as often as it
    says. "drawn allowances" draws what real benches do too. "fixed 6" is one k of 6 functions, and draws all else."""
    kind, number = cell.split()
    began = time.perf_counter()
    fixed, functions = kind == "fixed", int(number) if kind == "fixed" else FitSettings().functions
    try:
        allowances = ALLOWED if number == "allowances" else frozenset()
        drawn = draw(seed, functions=functions, fixed=fixed, allowances=allowances)
        found = fit_from_nothing(drawn.observations, settings=FitSettings(functions=functions, allowances=allowances))
    except (LearningError, MechanicsError) as wrong:
        return Run(cell, seed, failure=f"{type(wrong).__name__}: {wrong}")
    error = thirds(drawn.problem.layout.spline) @ (found.mean[:functions] - drawn.x[:functions])
    return replace(
        compared(found, np.asarray(drawn.stiffness(S)), cell, seed),
        thirds_error=tuple(error.tolist()),
        thirds_variance=tuple(least_variance(drawn, prior_of_k=not fixed).tolist()),
        seconds=time.perf_counter() - began,
    )


def compared(found: Posterior, truth: Array, cell: str, seed: int) -> Run:
    """A fit against k (35,) at S."""
    band = found.band(S, 0.6826894921370859)
    bands = [found.band(S, level) for level in LEVELS]
    return Run(
        cell,
        seed,
        error=tuple(np.log(band.k / truth).tolist()),
        sd=tuple((0.5 * np.log(band.high / band.low)).tolist()),
        inside=tuple(tuple(((truth > b.low) & (truth < b.high)).tolist()) for b in bands),
        identified=tuple(band.identified.tolist()),
        converged=found.optimum.converged,
    )


def fit_from_nothing(seen: Observations, *, gain_sd: float = 0.0, settings: FitSettings = FitSettings()) -> Posterior:
    """Fit from an even stiffness: half the largest moment over the largest turn; stiffer where the beam snaps through.

    Raises
    ------
    LearningError
        As `fit`, from the stiffest start too.
    """
    moment = float(np.nanmax(np.linalg.norm(seen.force[seen.loaded], axis=1))) * seen.length
    start = 0.5 * moment / max(float(np.nanmax(np.abs(np.median(seen.angle[seen.loaded], axis=1)))), 0.1)
    for factor in (1.0, 3.0):
        try:
            return fit([seen], factor * start, gain_sd=gain_sd, settings=settings)
        except LearningError as wrong:
            if "stiffer" not in str(wrong):
                raise
    return fit([seen], 10.0 * start, gain_sd=gain_sd, settings=settings)
