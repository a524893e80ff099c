"""`Beam`: length, profiles along it, and its shape under a load."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.continuation import Side, equilibrium
from onebend.beam.loads import push, weight
from onebend.beam.problem import GridMemory
from onebend.beam.statics import Equilibrium
from onebend.beam.stiffness import POISSON, Profile, RectangularSection, Uniform, profile_from_dict
from onebend.errors import MechanicsError
from onebend.progress import one_blas_thread
from onebend.records import Array, PointMass


@dataclass(frozen=True)
class Shape:
    """Equilibrium shapes: one, or T where T forces were given (arrays then lead with T)."""

    solved: Equilibrium
    single: bool

    def xy(self, s: ArrayLike) -> Array:
        """(..., 2) m, positions at `s`."""
        out = self.solved.xy(np.atleast_1d(np.asarray(s, dtype=float)))
        return self._plain(out[:, 0] if np.ndim(s) == 0 else out)

    def angle(self, s: ArrayLike) -> Array:
        """(...) rad, the tangent's angle at `s`."""
        out = self.solved.angle(np.atleast_1d(np.asarray(s, dtype=float)))
        return self._plain(out[:, 0] if np.ndim(s) == 0 else out)

    @property
    def stable(self) -> bool:
        """Whether all shapes are stable."""
        return bool(np.all(self.solved.stable))

    def _plain(self, values: Array) -> Array:
        return np.asarray(values[0]) if self.single else values


@dataclass(frozen=True, repr=False)
class Beam:
    """A planar slender beam, clamped at s = 0. It stretches and shears only where a thickness is given."""

    length: float  # L, m
    stiffness: Profile  # k(s) = E I / L, N m
    rest_curvature: Profile = field(default_factory=lambda: Uniform(0.0))  # q0(s), rad
    clamp_angle: float = 0.0  # alpha0, rad
    mass_per_length: Profile = field(default_factory=lambda: Uniform(0.0))  # mu(s), kg/m
    thickness: float | None = None  # h0, m, in the plane of bending where k is its mean; None: no stretch, no shear
    poisson: float = POISSON  # nu
    varies: Literal["thickness", "width"] = "thickness"  # the dimension whose variation makes k(s) vary
    masses: tuple[PointMass, ...] = ()  # on the beam, besides its own mass

    def __post_init__(self) -> None:
        if not self.length > 0.0:
            raise MechanicsError(f"a beam's length must be positive, got {self.length} m")
        _ = self.section  # validates
        for one in self.masses:
            if not (0.0 <= one.s <= 1.0 and 0.0 <= one.mass < math.inf):
                raise MechanicsError(f"a mass rides at s in [0, 1] and is 0 kg or more, got {one.mass} kg at {one.s}")

    def __repr__(self) -> str:
        k = self.stiffness(np.linspace(0.0, 1.0, 201))
        return f"Beam(length={self.length:.4g} m, k={k.min():.3g} to {k.max():.3g} N m)"

    @property
    def section(self) -> RectangularSection | None:
        """Gives EA and kGA; None without stretch and shear."""
        return None if self.thickness is None else RectangularSection(self.thickness, self.poisson, self.varies)

    @cached_property
    def memory(self) -> GridMemory:
        """Cached arrays; results do not depend on them."""
        return GridMemory()

    def __getstate__(self) -> dict[str, Any]:
        """Without the cache."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}

    @one_blas_thread
    def equilibrium(
        self,
        force: ArrayLike,
        at_s: ArrayLike = 1.0,
        *,
        gravity: ArrayLike | None = None,
        fall: Side | None = None,
    ) -> Shape:
        """The shape under a force (2,) or forces (T, 2) [N] at `at_s`, a number or (T,), and the beam's weight.

        Args:
            gravity: (2,) or (T, 2) m/s^2 in the beam's frame.
            fall: None stays on the branch that grows from rest, even where it is unstable. With "left" or "right" the
                beam falls where that branch loses stability or ends; the side decides only where the loads do not.

        Raises `MechanicsError`: k(s) is not positive, the branch ends before the full load (snap-through) without
        `fall`, or the fall finds no equilibrium.
        """
        if fall not in (None, "left", "right"):
            raise MechanicsError(f"a beam falls to its 'left' or to its 'right' (or None: not at all), got {fall!r}")
        loads = push(force, at_s)
        if gravity is not None:
            loads = loads + weight(gravity)
        solved = equilibrium(self, loads, fall=fall)
        if not np.all(solved.converged):
            frame = int(np.flatnonzero(~solved.converged)[0])
            raise MechanicsError(
                f"load {frame}: the equilibrium that grows from rest ends at {solved.load_factor[frame]:.1%} "
                "of the load; beyond it the beam snaps through. "
                + ("Give a smaller load, or a side to `fall` to" if fall is None else "It falls to no stable shape")
            )
        return Shape(solved, single=np.ndim(force) == 1)

    def as_dict(self) -> dict[str, Any]:
        """Plain data for `Beam.from_dict`."""
        section = {"thickness_m": self.thickness, "poisson": self.poisson, "varies": self.varies}
        return {
            "length_m": self.length,
            "stiffness_N_m": self.stiffness.as_dict(),
            "rest_curvature_rad": self.rest_curvature.as_dict(),
            "clamp_angle_rad": self.clamp_angle,
            "mass_per_length_kg_m": self.mass_per_length.as_dict(),
            **({} if self.thickness is None else section),
            **({"masses": [{"s": m.s, "mass_kg": m.mass} for m in self.masses]} if self.masses else {}),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Beam:
        """Inverse of `as_dict`. Raises `MechanicsError` for a missing entry."""
        try:
            return cls(
                length=float(data["length_m"]),
                stiffness=profile_from_dict(data["stiffness_N_m"]),
                rest_curvature=profile_from_dict(data["rest_curvature_rad"]),
                clamp_angle=float(data["clamp_angle_rad"]),
                mass_per_length=profile_from_dict(data["mass_per_length_kg_m"]),
                thickness=None if data.get("thickness_m") is None else float(data["thickness_m"]),
                poisson=float(data.get("poisson", POISSON)),
                varies=data.get("varies", "thickness"),
                masses=tuple(PointMass(float(m["s"]), float(m["mass_kg"])) for m in data.get("masses", ())),
            )
        except KeyError as error:
            raise MechanicsError(f"the beam's data lack {error}") from error
