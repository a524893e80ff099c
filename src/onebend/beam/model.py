"""The beam as users meet it: a frozen record with a length, profiles along it, and its shape under a load."""

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
    """The beam in equilibrium: one shape, or T where T forces were given (all arrays then lead with T)."""

    solved: Equilibrium
    single: bool

    def xy(self, s: ArrayLike) -> Array:
        """(..., 2) m, positions at `s` (a number or an array)."""
        out = self.solved.xy(np.atleast_1d(np.asarray(s, dtype=float)))
        return self._plain(out[:, 0] if np.ndim(s) == 0 else out)

    def angle(self, s: ArrayLike) -> Array:
        """rad, the tangent's angle at `s` (a number or an array)."""
        out = self.solved.angle(np.atleast_1d(np.asarray(s, dtype=float)))
        return self._plain(out[:, 0] if np.ndim(s) == 0 else out)

    @property
    def stable(self) -> bool:
        """Whether every shape is a stable equilibrium."""
        return bool(np.all(self.solved.stable))

    def _plain(self, values: Array) -> Array:
        return np.asarray(values[0]) if self.single else values


@dataclass(frozen=True)
class Beam:
    """A planar slender beam, clamped at s = 0. It stretches and shears where a thickness is given, else it does not."""

    length: float  # L, m
    stiffness: Profile  # k(s) = E I / L, N m
    rest_curvature: Profile = field(default_factory=lambda: Uniform(0.0))  # q0(s), rad
    clamp_angle: float = 0.0  # alpha0, rad
    mass_per_length: Profile = field(default_factory=lambda: Uniform(0.0))  # mu(s), kg/m
    thickness: float | None = None  # h0, m, in the plane of bending where k is its mean; None: no stretch, no shear
    poisson: float = POISSON  # nu
    varies: Literal["thickness", "width"] = "thickness"  # what makes k(s) vary
    masses: tuple[PointMass, ...] = ()  # that ride on it, besides its own

    def __post_init__(self) -> None:
        if not self.length > 0.0:
            raise MechanicsError(f"a beam's length must be positive, got {self.length} m")
        _ = self.section  # checks its numbers
        for one in self.masses:
            if not (0.0 <= one.s <= 1.0 and 0.0 <= one.mass < math.inf):
                raise MechanicsError(f"a mass rides at s in [0, 1] and is 0 kg or more, got {one.mass} kg at {one.s}")

    @property
    def section(self) -> RectangularSection | None:
        """From which EA and kGA follow; None for a beam that neither stretches nor shears."""
        return None if self.thickness is None else RectangularSection(self.thickness, self.poisson, self.varies)

    @cached_property
    def memory(self) -> GridMemory:
        """What it remembers from one equilibrium to the next; the numbers do not depend on it."""
        return GridMemory()

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone: what is remembered is not copied."""
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
        """The beam's shape under a force (2,) or forces (T, 2) [N] on it at `at_s`, one place or (T,), and its weight.

        `gravity`: (2,) or (T, 2) m/s^2 in the beam's frame. `fall`: None stays on the branch that grows from rest, even
        where it is unstable. "left" or "right": where that branch loses stability or ends, the beam falls to where it
        stands; to this side of it, where the loads leave that open (a perfectly axial force).

        Raises `MechanicsError`: k(s) is not positive somewhere, or the branch of equilibria that grows from rest ends
        before the full load (the beam snaps through) and no `fall` was asked for, or led nowhere.
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
        """Plain data from which `Beam.from_dict` makes an equal beam."""
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
        """Inverse of `as_dict`. Raises `MechanicsError` where an entry is missing."""
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
