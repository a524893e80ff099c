"""Settings of the live learner, and what follows from them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from onebend.errors import LearningError
from onebend.learning import normal
from onebend.learning.allowances import LIVE_ALLOWANCES
from onebend.learning.hyperparameters import CHOSEN, SPREAD
from onebend.learning.normal import RHO, TAU, InformationForm
from onebend.learning.parameters import Spline
from onebend.recording.force_noise import LOAD
from onebend.records import Array, ForceNoise

_LEVEL = 0.05  # of the largest force: one sd of the log's zero
_WRONG = 4.0  # times the error that comes with the load, while the model misses the tags by far
UNKNOWN_FORCE = ForceNoise(white=0.01, coloured=0.01, tau=0.3, walk=0.003, load=np.nan)


@dataclass(frozen=True)
class OnlineSettings:
    """How the live learner works. Sizes of noise are first values; unless `adapt` is off, it learns them."""

    functions: int = 45  # of the spline of log k
    key_frames: int = 30
    # one sd of `STATED_ERRORS` by name, else as usual; no "clock": camera and force log share one; no "scale": the
    # camera is calibrated
    sds: Mapping[str, float] = field(default_factory=dict)
    marker_noise: float = 1.5  # over what the tags' covariances say
    # `level` comes on top of 5 % of the largest force; `load` NaN: 3 % of it
    force: ForceNoise = UNKNOWN_FORCE
    memory_doubt: float = float(SPREAD[CHOSEN.index("memory")])  # sd of the log of `force.tau`
    roughness: float = TAU  # of log k
    steps: float = RHO  # of log k
    adapt: bool = True  # False: the hyperparameters keep their first values
    bulk: float = 3.0  # sd: a tag that fits worse gets less weight; infinite: plain least squares
    gate: float = 8.0  # sd: a tag farther from where it is expected is left out,
    patience: int = 8  # unless it is that far off in so many frames in a row
    step: float = 0.7  # of log k: farther from where it was linearised nothing is believed
    allowances: frozenset[str] = LIVE_ALLOWANCES  # what a real beam and bench may also do
    thickness: float | None = None  # m, of the section in the plane of bending; None: not known
    tag_size: float | None = None  # m, side of a tag's black square; None: not known

    def check(self) -> None:
        """Raises `LearningError` for settings without meaning."""
        force = self.force
        if not min(force.white, force.coloured, force.tau, force.walk) > 0.0 or force.level < 0.0 or force.load < 0.0:
            raise LearningError(f"the parts of force must be positive, got {force}")
        for name in ("marker_noise", "memory_doubt", "roughness", "steps", "bulk", "gate", "step"):
            if not getattr(self, name) > 0.0:
                raise LearningError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("thickness", "tag_size"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise LearningError(f"{name} must be a length in m, got {value}")
        if not self.allowances <= LIVE_ALLOWANCES:
            other = ", ".join(sorted(self.allowances - LIVE_ALLOWANCES))
            raise LearningError(f"the live learner has no allowance for: {other}")
        for name, least in (("functions", 5), ("key_frames", 5), ("patience", 1)):
            if getattr(self, name) < least:
                raise LearningError(f"{name} must be at least {least}, got {getattr(self, name)}")


@dataclass(frozen=True)
class LiveHyperparameters:
    """The hyperparameters but those of log k's prior, which are drawn."""

    marker: float  # noise of the tags over what their covariances say
    misfit: float  # of the tags, likewise; 0 while it is no more than noise
    white: float  # N, force error of every frame
    coloured: float  # N, Ornstein-Uhlenbeck part
    memory: float  # s, its correlation time
    walk: float  # N per root second
    load: float  # error that comes with the load, over the size expected before the data

    @property
    def causes_of_width(self) -> dict[str, float]:
        """What the width of the band follows from, beside the frames."""
        force = math.hypot(self.coloured, self.white)
        return {"tags": max(self.marker, self.misfit), "force": force, "drift": self.walk, "load": self.load}


def expected_error(settings: OnlineSettings, largest: float, far_off: bool) -> ForceNoise:
    """The force log's error before the data. `largest`: N, the largest force so far; `far_off`: the residuals are far
    above the tags' noise, so the force may also be further off than its log says."""
    first = settings.force
    load = (LOAD * largest if np.isnan(first.load) else first.load) * (_WRONG if far_off else 1.0)
    return replace(first, level=float(np.hypot(first.level, max(_LEVEL * largest, first.coloured))), load=load)


# Hyperparameters of log k's prior: a few Markov chains run while frames come, and their last draws are kept. Given the
# hyperparameters log k is normal, so its mean and covariance are averages over draws.

_CHAINS = 2
_KEPT_STEPS = 10  # the last steps, whose draws are kept


class StiffnessChains:
    """The chains and their last draws."""

    def __init__(self, spline: Spline, level: float, tau: float, rho: float) -> None:
        """`level`: prior mean of log k; `tau`, `rho`: first values of roughness and steps."""
        self._spline, self._level = spline, level
        self._rng = np.random.default_rng(0)
        first = np.append(np.log([tau, rho]), np.ones(len(spline.share)))
        # (B KEPT, 2 p + 1) where the chains stood, the last first
        self.drawn = np.tile(first, (_CHAINS * _KEPT_STEPS, 1))

    @property
    def parts(self) -> Array:
        """(n,) geometric means of the parts' variances over the kept draws: the prior for the estimate. A few draws of
        large steps would dominate an arithmetic mean."""
        variances, _ = normal.part_variances(self._spline, self.drawn[:, :2], self.drawn[:, 2:])
        return np.asarray(np.exp(np.mean(np.log(variances), axis=0)))

    def step(self, stiffness_form: InformationForm) -> None:
        target = normal.target_of(self._spline, [stiffness_form], self._level, _CHAINS)
        (now,) = normal.drawn_chains(target, normal.Draws(_CHAINS, 0, 1), self.drawn[:_CHAINS], self._rng)
        self.drawn = np.concatenate([now.stand, self.drawn[:-_CHAINS]])
