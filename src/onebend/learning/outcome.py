"""What learning and validation return: frozen results that carry their reasons."""

from __future__ import annotations

from dataclasses import dataclass

from onebend.beam.model import Beam
from onebend.records import Array, BoolArray, IntArray, Remark


@dataclass(frozen=True)
class Comparison:
    """One recording against a simulated beam under the measured forces (Fig. 5 of the paper)."""

    name: str
    frame: IntArray  # (T,) index in the video; only the frames that were simulated
    time: Array  # (T,) s
    tag_id: IntArray  # (m,)
    marker_s: Array  # (m,)
    measured: Array  # (T, m, 2) m, NaN where missing
    predicted: Array  # (T, m, 2) m
    force: Array  # (T, 2) N
    push_s: Array  # (T,)
    stable: BoolArray  # (T,) the simulated equilibrium is stable
    rms: Array  # (m,) m, root mean square distance per marker over all frames where it was seen
    sensor_rms: Array  # (m,) m, the part that the noise left in the force alone explains (first order); NaN if unknown
    likely_rms: (
        Array  # (m,) m, as the same noise, the band of k(s) and the push's tolerances let expect; NaN if unknown
    )
    remarks: tuple[Remark, ...] = ()
    static: bool = False  # bench poses: `time` counts them


@dataclass(frozen=True)
class Explained:
    """A recording as a fit explains it, its nuisances applied; `comparison.force` is the corrected force."""

    comparison: Comparison  # over the frames that the fit used
    line: Array  # (T, places, 2) m, the beam's centre line from the clamp to the tip
    logged: Array  # (T, 2) N, the force as logged


@dataclass(frozen=True)
class Trial:
    """One row of the paper's table: n curvature modes, m stiffness functions."""

    n: int
    m: int
    coefficients: Array  # (m,) gamma of (17), N m
    rms: Array  # (tags,) m, per marker in some hundred frames of the training recording; NaN if it cannot be simulated
    bic: float  # infinity if out of the running
    lowest_k: float  # N m, min of k(s) on [0, 1]
    condition: float  # of X in X gamma = Y
    why_out: str = ""  # empty if in the running


@dataclass(frozen=True)
class Learned:
    """The learned beam, and how it came about."""

    beam: Beam
    method: str  # "regression" or "paper"
    family: str  # "gaussians" or "powers"
    trials: tuple[Trial, ...]
    chosen: int  # index in `trials`
    training: Comparison
    remarks: tuple[Remark, ...] = ()
