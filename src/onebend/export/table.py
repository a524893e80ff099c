"""The beam as a table along s: CSV-like columns for NumPy (.npz) and Parquet."""

from __future__ import annotations

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.records import Array

PLACES = 201


def columns(beam: Beam, uncertain: UncertainStiffness | None = None) -> dict[str, Array]:
    """Name, with unit, to (201,) values: s, k and its 95 % band, EI and its band, curvature at rest, mass per metre.

    The band is NaN where none was learned; `identified` is then 0, as it is where the data did not tell or the band
    is not to be trusted.
    """
    s = np.linspace(0.0, 1.0, PLACES)
    k = np.asarray(beam.stiffness(s))
    low = high = np.full(PLACES, np.nan)
    identified = np.zeros(PLACES)
    if uncertain is not None:
        band = uncertain.band(s)
        low, high, identified = band.low, band.high, band.identified.astype(float)
    return {
        "s": s,
        "s_m": beam.length * s,
        "k_N_m": k,
        "k_lo_N_m": low,
        "k_hi_N_m": high,
        "EI_N_m2": beam.length * k,
        "EI_lo_N_m2": beam.length * low,
        "EI_hi_N_m2": beam.length * high,
        "identified": identified,
        "rest_curvature_1_m": np.asarray(beam.rest_curvature(s)) / beam.length,
        "mass_per_length_kg_m": np.asarray(beam.mass_per_length(s)),
    }
