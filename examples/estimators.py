"""onebend as scikit-learn estimators, so that cross-validation and pipelines apply. Needs `onebend[sklearn]`.

`StiffnessRegression` is the paper's linear problem `X gamma = Y` (18) on plain arrays; `regression_rows` makes X and Y.
`StiffnessDistribution` is k(s) with its sd, learned from recordings in the space of the markers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import _check_sample_weight, check_is_fitted, validate_data

from onebend.beam.section import one_modulus
from onebend.errors import LearningError
from onebend.learning.frames import usable_frames
from onebend.learning.optimizer import FitSettings
from onebend.learning.outcome import stated_section
from onebend.learning.paper import Family, assemble, basis, column_sizes, least_squares, literal_rows, solve_states
from onebend.learning.posterior import fit
from onebend.learning.start import start_of, with_mass
from onebend.learning.validation import validate
from onebend.progress import one_blas_thread
from onebend.records import Array, Observations


@one_blas_thread
def regression_rows(
    observations: Observations, n: int, m: int, *, family: Family = "gaussians", width: float | None = None
) -> tuple[Array, Array]:
    """X (R, m) and Y (R,) of the paper's `X gamma = Y` (17), (18): n rows a usable frame.

    Args:
        n: curvature modes. m: stiffness functions, of this `family` and `width` (see `Settings`).

    Raises:
        LearningError: no frame can be used.
    """
    states = solve_states(observations, n, with_angles=False)
    use = usable_frames(observations) & states.converged & (states.data >= n)
    if not np.any(use):
        raise LearningError(f"{observations.source.name}: no frame shows enough tags under load for n = {n}")
    return literal_rows(assemble(observations, states), use, basis(family, m, width)[0])


class StiffnessRegression(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """`X gamma = Y` (18) by an orthogonal decomposition with scaled columns, or with gamma >= 0.

    Parameters
    ----------
    positive : bool, default=False
        Gaussians with positive heights make a stiffness that is positive everywhere.

    Attributes
    ----------
    coef_ : ndarray of shape (m,)
        gamma, N m.
    condition_ : float
        Condition number of X after its columns were scaled; infinity where it has not full rank.
    """

    def __init__(self, positive: bool = False) -> None:
        self.positive = positive

    def fit(self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> StiffnessRegression:
        """Least squares over the rows, each counted `sample_weight` times."""
        X, y = validate_data(self, X, y, y_numeric=True, dtype=np.float64)
        root = np.sqrt(_check_sample_weight(sample_weight, X, ensure_non_negative=True))
        x, target = X * root[:, None], y * root
        self.coef_, singular = least_squares(x, target)
        if self.positive:
            scale = column_sizes(x)
            self.coef_ = np.asarray(nnls(x / scale, target)[0] / scale)
        full = len(singular) == x.shape[1] and singular[-1] > 0.0
        self.condition_ = float(singular[0] / singular[-1]) if full else np.inf
        return self

    def predict(self, X: ArrayLike) -> Array:
        """(R,) `X gamma`."""
        check_is_fitted(self)
        return np.asarray(validate_data(self, X, reset=False, dtype=np.float64) @ self.coef_)


class StiffnessDistribution(BaseEstimator):  # type: ignore[misc]
    """k(s) with its standard deviation, from one or several recordings of a beam (`onebend.observe`).

    The samples are recordings, so scikit-learn's cross-validation over a list of them leaves whole recordings out.

    Parameters
    ----------
    functions : int, default=45
        B-splines of log k(s).
    most_frames : int, default=500
        Frames that are used of each recording.
    gain_sd : float, default=0
        Of the force sensor's gain; it widens k everywhere by one common factor.

    Attributes
    ----------
    posterior_ : onebend.Posterior
        All that the fit found.
    beam_ : onebend.Beam
        The most probable beam.
    modulus_ : tuple of three floats, or None
        Young's modulus [Pa] and its 95 % band, where the recordings state k(s) to go with the section.
    """

    def __init__(self, functions: int = FitSettings.functions, most_frames: int = 500, gain_sd: float = 0.0) -> None:
        self.functions = functions
        self.most_frames = most_frames
        self.gain_sd = gain_sd

    def fit(self, X: Sequence[Observations], y: Any = None) -> StiffnessDistribution:  # noqa: ARG002
        """Learn from the recordings `X`; `y` is not used.

        Raises:
            LearningError: as `onebend.fit`.
        """
        recordings = with_mass(_recordings(X))
        settings = FitSettings(functions=self.functions, most_frames=self.most_frames)
        self.posterior_ = fit(recordings, start_of(recordings, None), settings=settings, gain_sd=self.gain_sd)
        self.beam_ = self.posterior_.beam
        self.modulus_ = one_modulus(self.posterior_.stiffness, self.beam_.length, stated_section(recordings))
        return self

    def predict(self, s: ArrayLike, return_std: bool = False) -> Array | tuple[Array, Array]:
        """k [N m] at places `s` in [0, 1], shape (S,) or (S, 1); with `return_std` its standard deviation as well.

        The mean and sd are those of k where log k is normal; the band of `posterior_` has the quantiles.

        Raises:
            LearningError: a place outside [0, 1].
        """
        check_is_fitted(self)
        places = np.asarray(s, dtype=float).reshape(-1)
        if not np.all((places >= 0.0) & (places <= 1.0)):
            raise LearningError("places along the beam are between 0 (clamp) and 1 (tip)")
        uncertain = self.posterior_.stiffness
        log_k, sd = uncertain.log_at(places)
        variance = sd**2 + uncertain.gain_sd**2
        mean = np.exp(log_k + 0.5 * variance)
        return (mean, mean * np.sqrt(np.expm1(variance))) if return_std else mean

    def score(self, X: Sequence[Observations], y: Any = None) -> float:  # noqa: ARG002
        """Minus the root mean square distance [m] of the markers on these recordings, so that more is better."""
        check_is_fitted(self)
        found = [validate(self.beam_, one) for one in _recordings(X)]
        squared = np.concatenate([np.sum((one.measured - one.predicted) ** 2, axis=-1).ravel() for one in found])
        return -float(np.sqrt(np.nanmean(squared)))

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False  # recordings, not rows of numbers
        tags.target_tags.required = False
        return tags


def _recordings(given: Any) -> tuple[Observations, ...]:
    found = (given,) if isinstance(given, Observations) else tuple(given)
    if not found or not all(isinstance(one, Observations) for one in found):
        raise LearningError("give recordings as `onebend.observe` returns them: a list of Observations")
    return found
