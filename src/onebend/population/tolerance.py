"""Pass or fail against a tolerance band of k(s), with the errors that are to be expected of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from onebend.errors import ResultsError
from onebend.population.curves import Objects
from onebend.records import Array
from onebend.text_files import csv_rows

COLUMNS = ("s", "low_N_m", "high_N_m")
DRAWS = 4000
PASSES = 0.5  # probability of lying inside, from which an object passes


@dataclass(frozen=True)
class Tolerance:
    """Limits of k, straight between places in the logarithm; what lies outside the places is not asked."""

    s: Array
    low: Array  # N m
    high: Array  # N m


@dataclass(frozen=True)
class Judgement:
    """What passes, how sure that is, and how often it is wrong."""

    inside: Array  # (O,) probability that k(s) lies inside everywhere
    passes: float  # probability from which an object passes
    false_passes: float  # share of those that pass that is expected to lie outside; NaN: none passes
    false_fails: float  # share of those that fail that is expected to lie inside; NaN: none fails

    @property
    def passed(self) -> Array:
        """(O,) bool."""
        return np.asarray(self.inside >= self.passes)


def read_tolerance(path: Path) -> Tolerance:
    """The band of a CSV with the columns `s, low_N_m, high_N_m`.

    Raises:
        ResultsError: it cannot be read, or is no band; the message names the line.
    """
    rows = list(csv_rows(path, ResultsError))
    header = [name.strip() for name in rows[0][1]] if rows else []
    if absent := [name for name in COLUMNS if name not in header]:
        raise ResultsError(f"{path} has no column {absent[0]}. A tolerance has {', '.join(COLUMNS)}")
    at = [header.index(name) for name in COLUMNS]
    values: list[list[float]] = []
    for line, cells in rows[1:]:
        try:
            s, low, high = (float(cells[i]) for i in at)
        except (ValueError, IndexError):
            raise ResultsError(f"{path}, line {line}: {', '.join(COLUMNS)} are three numbers. Write them") from None
        if not (0.0 <= s <= 1.0 and 0.0 < low < high < np.inf):
            raise ResultsError(f"{path}, line {line}: s is from 0 to 1, and 0 < low_N_m < high_N_m. Correct it")
        if values and s <= values[-1][0]:
            raise ResultsError(f"{path}, line {line}: s does not grow from line to line. Sort the lines")
        values.append([s, low, high])
    if len(values) < 2:
        raise ResultsError(f"{path} has {len(values)} lines of numbers; a band needs two or more. Add some")
    return Tolerance(*np.array(values).T)


def judge(objects: Objects, s: Array, common_sd: float, band: Tolerance, passes: float = PASSES) -> Judgement:
    """Probabilities by draws from each object's k(s), the same for every call.

    Args:
        s: places of the objects' curves.
    """
    inside = inside_of(objects, s, common_sd, band)
    judged = inside >= passes
    return Judgement(
        inside,
        passes,
        float(np.mean(1.0 - inside[judged])) if judged.any() else float("nan"),
        float(np.mean(inside[~judged])) if not judged.all() else float("nan"),
    )


def inside_of(objects: Objects, s: Array, common_sd: float, band: Tolerance) -> Array:
    """(M,) probability that each k(s) lies inside at every place from the band's first to its last."""
    places = (s >= band.s[0] - 1e-9) & (s <= band.s[-1] + 1e-9)
    if not places.any():
        raise ResultsError("the tolerance lies between two places of k(s). Let it span 0.1 or more of s")
    low, high = (np.interp(s[places], band.s, np.log(edge)) for edge in (band.low, band.high))
    normal = np.random.default_rng(0).standard_normal((DRAWS, len(s) + 1))
    found = np.empty(len(objects.mean))
    for i, (mean, covariance) in enumerate(zip(objects.mean, objects.covariance, strict=True)):
        values, vectors = np.linalg.eigh(covariance)
        root = (vectors * np.sqrt(np.maximum(values, 0.0)))[places]
        drawn = mean[places] + normal[:, :-1] @ root.T + common_sd * normal[:, -1:]
        found[i] = np.mean(np.all((drawn >= low) & (drawn <= high), axis=1))
    return found
