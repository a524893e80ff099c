"""Settings of the live learner, and what follows from them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from onebend.errors import LearningError
from onebend.learning.allowances.causal import CAUSAL_ALLOWANCES
from onebend.learning.allowances.chosen import AllowanceName
from onebend.learning.inference.stiffness_prior import RHO, TAU
from onebend.learning.live.force_hyperparameters import MEMORY_DOUBT
from onebend.learning.live.force_process import ForceProcess
from onebend.learning.live.key_frame_posterior import LiveHyperparameters
from onebend.learning.live.session import SmootherSettings
from onebend.learning.model.force_error import LOAD
from onebend.learning.model.parameters import Priors

_LEVEL = 0.05  # of the largest force: one sd of the log's zero
_WRONG = 4.0  # times the error that comes with the load, while the model misses the tags by far
_WALK = 0.3  # of the force's noise, per root second: the zero drifts by the noise in ten seconds


@dataclass(frozen=True)
class OnlineSettings:
    """How the live learner works. Sizes of noise are first values; unless `adapt` is off, it learns them."""

    functions: int = 45  # of the spline of log k
    key_frames: int = 30
    renewed: int = 5  # key frames linearised anew with every other update; one with those between
    priors: Priors = field(default_factory=Priors)  # `clock` None: camera and force log share one
    placement_sd: float = 5e-4  # m, of the tags' places and of the clamp's
    rest_unknown: bool = True  # the beam may be curved when free
    calibrated: bool = True  # False: all lengths have a common unknown scale
    marker_noise: float = 1.5  # over what the tags' covariances say
    force_noise: float = 0.01  # N, sd of the log's coloured error
    force_white: float | None = None  # N, sd of its error that is anew in every frame; None: as the coloured one
    force_walk: float | None = None  # N per root second, of its drift; None: 0.3 of the coloured one a second
    force_zero: float = 0.0  # N, sd of the log's zero, on top of 5 % of the largest force
    force_memory: float = 0.3  # s, correlation time of the log's coloured error
    memory_doubt: float = MEMORY_DOUBT  # sd of the log of that time
    force_load: float | None = None  # N, sd of its error that comes with the load; None: 3 % of the largest force
    roughness: float = TAU  # of log k
    steps: float = RHO  # of log k
    adapt: bool = True  # False: the hyperparameters keep their first values
    bulk: float = 3.0  # sd: a tag that fits worse gets less weight; infinite: plain least squares
    gate: float = 8.0  # sd: a tag farther from where it is expected is left out,
    patience: int = 8  # unless it is that far off in so many frames in a row
    step: float = 0.7  # of log k: the most that one update moves it
    allowances: frozenset[AllowanceName] = CAUSAL_ALLOWANCES  # what a real beam and bench may also do
    thickness: float | None = None  # m, of the section in the plane of bending; None: not known
    tag_size: float | None = None  # m, side of a tag's black square; None: not known

    @property
    def smoother(self) -> SmootherSettings:
        """The part that the smoother needs."""
        return SmootherSettings(
            key_frames=self.key_frames,
            renewed=self.renewed,
            zero=self.force_zero,
            least_zero=self.force_noise,
            load=self.force_load,
            roughness=self.roughness,
            steps=self.steps,
            memory_doubt=self.memory_doubt,
            adapt=self.adapt,
            bulk=self.bulk,
            gate=self.gate,
            patience=self.patience,
            step=self.step,
        )

    @property
    def hyperparameters(self) -> LiveHyperparameters:
        """The values that the hyperparameters begin with."""
        return LiveHyperparameters(
            marker=self.marker_noise,
            white=self.force_noise if self.force_white is None else self.force_white,
            coloured=self.force_noise,
            memory=self.force_memory,
            walk=_WALK * self.force_noise if self.force_walk is None else self.force_walk,
            load=1.0,
        )

    def check(self) -> None:
        """Raises `LearningError` for settings without meaning."""
        sizes = ("marker_noise", "force_noise", "force_white", "force_walk", "force_memory", "memory_doubt")
        for name in (*sizes, "roughness", "steps", "bulk", "gate", "step"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise LearningError(f"{name} must be positive, got {value}")
        for name in ("force_zero", "force_load", "placement_sd"):
            value = getattr(self, name)
            if value is not None and not value >= 0.0:
                raise LearningError(f"{name} cannot be negative, got {value}")
        for name in ("thickness", "tag_size"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise LearningError(f"{name} must be a length in m, got {value}")
        if not self.allowances <= CAUSAL_ALLOWANCES:
            other = ", ".join(sorted(self.allowances - CAUSAL_ALLOWANCES))
            raise LearningError(f"the live learner has no allowance for: {other}")
        for name, least in (("functions", 5), ("key_frames", 5), ("renewed", 1), ("patience", 1)):
            if getattr(self, name) < least:
                raise LearningError(f"{name} must be at least {least}, got {getattr(self, name)}")


def force_process(
    settings: SmootherSettings, hyperparameters: LiveHyperparameters, largest: float, far_off: bool
) -> ForceProcess:
    """The force log's error. `largest`: N, the largest force so far; `far_off`: the residuals are far above the tags'
    noise, so the force may also be further off than its log says."""
    level = float(np.hypot(settings.zero, max(_LEVEL * largest, settings.least_zero)))
    load = hyperparameters.load * (LOAD * largest if settings.load is None else settings.load)
    if far_off:
        load *= _WRONG
    return ForceProcess(
        level, hyperparameters.walk, hyperparameters.coloured, hyperparameters.memory, hyperparameters.white, load
    )
