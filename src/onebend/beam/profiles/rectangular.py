"""A solid rectangular section: how far a beam stretches and shears follows from k(s) and one thickness.

Bending stiffness EI = k L, second moment I = A h^2 / 12, shear factor 5/6 (Timoshenko), G = E / (2 (1 + nu)):

    EA = 12 k L / h^2,   kGA = 5/6 EA / (2 (1 + nu)),   h(s) = h0 (k / mean k)^p

with p = 1/3 where the thickness makes k(s) vary (k goes with h^3) and p = 0 where the width does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from onebend.errors import MechanicsError
from onebend.records import Array, BoolArray, IntArray

POISSON = 0.48  # silicone and other rubbers: 0.45 to 0.5
SHEAR_FACTOR = 5.0 / 6.0  # of a rectangle


@dataclass(frozen=True)
class RectangularSection:
    """Thickness in the plane of bending, and what makes k(s) vary."""

    thickness: float | Array  # h0, m, where k is its mean along the beam: a number, or (T, 1) for T beams
    poisson: float = POISSON  # nu
    varies: Literal["thickness", "width"] = "thickness"
    share: float = 1.0  # of the stretch and shear that such a section has; 0: none

    def __post_init__(self) -> None:
        if not np.all(np.asarray(self.thickness) > 0.0):
            raise MechanicsError(f"a section's thickness must be positive, got {np.min(self.thickness):.3g} m")
        if not -1.0 < self.poisson <= 0.5:
            raise MechanicsError(f"Poisson's ratio lies in (-1, 0.5], got {self.poisson:g}")
        if self.varies not in ("thickness", "width"):
            raise MechanicsError(f"k(s) varies with 'thickness' or 'width', got {self.varies!r}")

    def take(self, chosen: IntArray | BoolArray) -> RectangularSection:
        """That of some beams of the batch."""
        h = self.thickness
        return self if np.ndim(h) == 0 else replace(self, thickness=np.asarray(h)[chosen])

    @property
    def exponent(self) -> float:
        """p of `h = h0 (k / mean k)^p`."""
        return 1.0 / 3.0 if self.varies == "thickness" else 0.0

    def compliance(self, k: Array, weights: Array, length: Array) -> tuple[Array, Array]:
        """1/EA and 1/kGA [1/N] at nodes of quadrature `weights` (Q,) or (T, Q); `length` () or (T, 1) m."""
        squared = self.share * np.asarray(self.thickness) ** 2
        if self.exponent:
            squared = squared * np.cbrt(k / _mean(k, weights)) ** 2
        stretch = np.asarray(squared / (12.0 * length * k))
        return stretch, stretch * (2.0 * (1.0 + self.poisson) / SHEAR_FACTOR)

    def log_by_stiffness(self, k: Array, weights: Array, functions: Array) -> Array:
        """(Q, P) or (T, Q, P): d log(1/EA), and equally d log(1/kGA), for coefficients of functions added to k [N m].

        `d log(1/EA) = (2 p - 1) dk / k - 2 p d(mean k) / mean k`.
        """
        out = (2.0 * self.exponent - 1.0) * functions / k[..., None]
        if self.exponent:
            mean = _mean(functions, weights[..., None], axis=-2) / _mean(k, weights)[..., None]
            out = out - 2.0 * self.exponent * mean
        return np.asarray(out)


def common_section(sections: Sequence[RectangularSection | None]) -> RectangularSection | None:
    """One section for a batch, of thickness (T, 1) where several beams differ in it; None where no beam has one.

    Raises:
        MechanicsError: some have one and others none, or they differ in more than the thickness.
    """
    first, *others = sections
    if first is None or not others or all(other == first for other in others):
        if any(other is not None for other in others) and first is None:
            raise MechanicsError("some beams of the batch have a thickness, others none: solve them apart")
        return first
    if any(o is None or (o.poisson, o.varies) != (first.poisson, first.varies) for o in others):
        raise MechanicsError("beams of one batch share Poisson's ratio and what varies; solve the others apart")
    return replace(first, thickness=np.array([[o.thickness] for o in (first, *others) if o is not None]))


def _mean(values: Array, weights: Array, axis: int = -1) -> Array:
    return np.asarray(np.sum(weights * values, axis=axis, keepdims=True))
