"""From parameters to natural frequencies, with exact derivatives, and what measured ones say of the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from onebend.beam.motion.actions import Actions
from onebend.beam.motion.dynamics import Body, body_of_nodes
from onebend.beam.motion.frequencies import frequency_slopes, shear_share
from onebend.beam.motion.vibration import Vibration, settle, vibration_of
from onebend.errors import MechanicsError
from onebend.learning.frequencies.frequency_data import FrequencyData, Posture
from onebend.learning.model.parameters import Layout
from onebend.records import Array

_LOAD_STEPS = 10  # where the weight at once is too much


@dataclass(frozen=True)
class PredictedFrequencies:
    """The frequencies of one recording's beam at parameters x (P,)."""

    data: FrequencyData
    layout: Layout
    x: Array
    vibrations: tuple[Vibration | None, ...]  # of each posture; None where the beam does not stand

    @cached_property
    def log(self) -> Array:
        """(N,) of Hz; NaN where the beam does not stand."""
        out = np.full(len(self.data.measured), np.nan)
        for posture, found in zip(self.data.postures, self.vibrations, strict=True):
            if found is not None:
                out[posture.rows] = np.log(found.frequency[posture.modes]) - 0.5 * np.log1p(self._shear(found, posture))
        return out

    def _shear(self, found: Vibration, posture: Posture) -> Array:
        """(n,) by which shear lowers the squares of the posture's frequencies."""
        data = self.data
        if data.section is None:
            return np.zeros(len(posture.modes))
        k = np.diag(found.body.stiffness) / data.grid.weights
        compliance = data.section.compliance(k, data.grid.weights, np.array(found.body.length))[1]
        return shear_share(found, compliance, posture.modes.tolist())

    @property
    def residuals(self) -> Array:
        """(N,) measured less predicted, over its sd."""
        return np.asarray((self.data.measured - self.log) / self.data.sd)

    @cached_property
    def slopes(self) -> Array:
        """(N, P) derivatives of `log` with all parameters; those of shear and rotary inertia, which are small, left
        out."""
        data, layout, x = self.data, self.layout, self.x
        out = np.zeros((len(data.measured), layout.size))
        k, parts = _stiffness(data, layout, x), layout.get(x, "mass")
        by_mass = data.mass.line_by_mass(k)
        carried = data.mass.line_by_stiffness(k, np.eye(len(k)), parts)  # (Q, Q): where the mass follows k(s)
        for posture, found in zip(data.postures, self.vibrations, strict=True):
            if found is None:
                continue
            by = frequency_slopes(found, posture.gravity, posture.modes.tolist())
            log_k = by.log_k if carried is None else by.log_k + by.mass_per_length @ carried
            blocks = {
                "stiffness": log_k @ data.on_nodes,
                "curvature": by.rest_curvature @ data.rest_on_nodes,
                "mass": by.mass_per_length @ by_mass,
                "length": by.log_length[:, None],
            }
            if data.patches is not None:
                blocks["patches"] = log_k @ data.patches
            for name, slopes in blocks.items():
                block = layout.index.get((name, -1))
                if block is not None and block.start >= 0:
                    out[posture.rows, block.where] = slopes
        return out


def predicted_frequencies(data: FrequencyData, layout: Layout, x: Array) -> PredictedFrequencies:
    """Vibrations about rest in every posture."""
    k = _stiffness(data, layout, x)
    line = data.written + data.mass.line(k, layout.get(x, "mass"))
    log_length = float(layout.get(x, "length")[0]) if ("length", -1) in layout.index else 0.0
    rest = data.rest_on_nodes @ layout.get(x, "curvature")
    length = data.length * np.exp(log_length)
    line, thick = np.exp(-log_length) * line, 0.0 if data.section is None else float(data.section.thickness)
    iota = line * thick**2 / 12.0
    bodies = [
        body_of_nodes(data.grid, length, k, line, rest, rotary_inertia=iota, points=posture.points)
        for posture in data.postures
    ]
    return PredictedFrequencies(data, layout, x, tuple(map(_vibration, bodies, data.postures)))


def _stiffness(data: FrequencyData, layout: Layout, x: Array) -> Array:
    """(Q,) N m."""
    log_k = data.on_nodes @ layout.get(x, "stiffness")
    if data.patches is not None and ("patches", -1) in layout.index:
        log_k = log_k + data.patches @ layout.get(x, "patches")
    return np.asarray(np.exp(log_k))


def _vibration(on: Body, posture: Posture) -> Vibration | None:
    """About rest in one posture; None where the beam does not stand there, or its mass is nonsense."""
    if not on.mass > 0.0:
        return None
    actions, count = Actions(gravity=posture.gravity), int(np.max(posture.modes)) + 1
    for steps in (1, _LOAD_STEPS):
        try:
            return vibration_of(on, settle(on, actions, load_steps=steps), actions, count=count)
        except (MechanicsError, np.linalg.LinAlgError):
            continue
    return None
