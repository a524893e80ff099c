"""The hierarchical model: objects scatter about their group's mean, recordings about their object.

    log k of a recording = mean of its group + its object's deviation + the occasion's deviation + the fit's error

Means have flat priors. Deviations are Gaussian with `covariance`, of which the share `lasting` is the object's. The
fit's error has the posterior covariance. Given the spreads all is linear and Gaussian. The spreads, equal in all
groups, are integrated over an adaptive grid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.polynomial.legendre import legvander
from scipy.special import log_ndtr, ndtr, ndtri

from onebend.errors import ResultsError
from onebend.files.publish import SUMMARY, changed_files, read_summary
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray, IntArray
from onebend.text_files import quoted

# Input.

JITTER = 1e-4  # sd of log k added at each place


@dataclass(frozen=True)
class PopulationTrial:
    """R recordings of O objects in G groups, at S places."""

    s: Array  # (S,)
    log_k: Array  # (R, S) log(N m)
    covariance: Array  # (R, S, S) of a recording's fit, without shared parts
    object_of: IntArray  # (R,)
    group_of: IntArray  # (O,)
    alike: Array  # (G, S, S) of the error that all fits of a group share, as from their prior
    common_sd: float = 0.0  # of log k: error of all recordings, as from the force sensor's scale

    @property
    def objects(self) -> int:
        return len(self.group_of)

    @property
    def groups(self) -> int:
        return int(self.group_of.max()) + 1

    @property
    def repeated(self) -> bool:
        return len(self.object_of) > self.objects

    @property
    def noise(self) -> Array:
        """(R, S, S) with a small diagonal, to be invertible."""
        return np.asarray(self.covariance + JITTER**2 * np.eye(len(self.s)))


# Means of Gaussian parts, and mixtures of normals.

HALVINGS = 50  # for a quantile


@dataclass(frozen=True)
class Means:
    """M means under N spreads."""

    mean: Array  # (N, M, S)
    covariance: Array  # (N, M, S, S)
    log_evidence: Array  # (N, M) of the parts, under a flat mean


def inverse(covariance: Array) -> tuple[Array, Array]:
    """(..., S, S) inverses and (...) log determinants, by Cholesky."""
    factor = np.linalg.cholesky(covariance)
    root = np.linalg.inv(factor)
    logs = 2.0 * np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
    return np.swapaxes(root, -1, -2) @ root, logs


def means(parts: Array, covariance: Array, whole_of: IntArray) -> Means:
    """Means of scattered parts, with flat priors.

    Args:
        parts: (N, R, S) or (1, R, S).
        covariance: (N, R, S, S) of the parts about their mean: error and scatter.
        whole_of: (R,) index of each part's mean, 0 to M - 1.
    """
    precision, logs = inverse(covariance)
    weighted = np.einsum("nrij,nrj->nri", precision, np.broadcast_to(parts, precision.shape[:-1]))
    squares = np.einsum("nri,nri->nr", weighted, np.broadcast_to(parts, weighted.shape))
    count = int(whole_of.max()) + 1
    together = np.stack([precision[:, whole_of == i].sum(axis=1) for i in range(count)], axis=1)
    pulled = np.stack([weighted[:, whole_of == i].sum(axis=1) for i in range(count)], axis=1)
    found, less = inverse(together)
    mean = np.einsum("nmij,nmj->nmi", found, pulled)
    own = np.stack([(logs + squares)[:, whole_of == i].sum(axis=1) for i in range(count)], axis=1)
    sizes = np.bincount(whole_of, minlength=count)
    turns = 0.5 * parts.shape[-1] * np.log(2.0 * np.pi) * (sizes - 1)
    evidence = -0.5 * (own + less - np.einsum("nmi,nmi->nm", mean, pulled)) - turns
    return Means(mean, found, evidence)


def quantile(weight: Array, mean: Array, sd: Array, share: float) -> Array:
    """(...) quantile of the mixture of N normals, `mean` and `sd` (N, ...)."""
    centre = ndtri(share) * sd + mean
    low, high = (np.asarray(edge(centre, axis=0)) for edge in (np.min, np.max))
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        below = np.tensordot(weight, ndtr((middle - mean) / sd), axes=1) < share
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(0.5 * (low + high))


def weighted_quantiles(values: Array, weight: Array, shares: tuple[float, ...]) -> tuple[float, ...]:
    places, number = np.unique(values, return_inverse=True)
    share_of = np.bincount(number, weight)
    before = (np.cumsum(share_of) - 0.5 * share_of) / share_of.sum()
    return tuple(float(np.interp(share, before, places)) for share in shares)


# Differences between objects of a group: a level, and a smooth shape.


@dataclass(frozen=True)
class Spreads:
    """N grid points of the spread within groups."""

    level_sd: Array  # (N,) of the mean of log k along the beam
    shape_sd: Array  # (N,) of log k less its mean, RMS
    length: Array  # (N,) correlation length of the shape, in s
    lasting: Array  # (N,) share of the variance that stays with an object

    def chosen(self, rows: BoolArray | IntArray | slice) -> Spreads:
        return Spreads(self.level_sd[rows], self.shape_sd[rows], self.length[rows], self.lasting[rows])


def shape_correlation(s: Array, length: float) -> Array:
    """(S, S) squared exponential of a curve less its mean, of mean variance one."""
    kernel = np.exp(-0.5 * ((s[:, None] - s) / length) ** 2)
    centred = kernel - kernel.mean(axis=0) - kernel.mean(axis=1)[:, None] + kernel.mean()
    return np.asarray(centred / np.mean(np.diagonal(centred)))


def covariance(spreads: Spreads, s: Array) -> Array:
    """(N, S, S) of log k(s) about the group's mean, without the fit's error."""
    found = np.empty((len(spreads.length), len(s), len(s)))
    for length in np.unique(spreads.length):
        rows = spreads.length == length
        level, shape = spreads.level_sd[rows, None, None] ** 2, spreads.shape_sd[rows, None, None] ** 2
        found[rows] = level + shape * shape_correlation(s, float(length))
    return found


def lasting_covariance(spreads: Spreads, s: Array) -> Array:
    """(N, 1, S, S) the object's part of `covariance`."""
    return np.asarray((spreads.lasting[:, None, None] * covariance(spreads, s))[:, None])


def log_prior(spreads: Spreads, trial: PopulationTrial) -> Array:
    """(N,) for equal steps of both log sds: p(sd) = 1 / (sd + e), e the sd of one fit: Student's band for large
    spreads, and no excess weight at zero."""
    noise = trial.covariance
    level = np.median(np.sqrt(np.maximum(noise.mean(axis=(1, 2)), 0.0)))
    whole = np.median(np.sqrt(np.mean(np.diagonal(noise, axis1=1, axis2=2), axis=1)))
    pairs = ((spreads.level_sd, level), (spreads.shape_sd, np.sqrt(max(whole**2 - level**2, 1e-12))))
    return np.asarray(sum(np.log(sd / (sd + error)) for sd, error in pairs))


LEAST_SD, MOST_SD = 1e-3, 3.0  # of log k
LENGTHS = (0.1, 0.25, 0.6)
POINTS, FEWER = 11, 7  # per axis of the grid; with a third axis
ROUNDS = 5  # of refinement, at most
TAIL = 1e-4  # weight that a range may lose on either side
AT_ONCE = 4_000_000  # size of the largest array


@dataclass(frozen=True)
class Fit:
    """N spreads with weights, and the groups' means under each."""

    trial: PopulationTrial
    spreads: Spreads
    weight: Array  # (N,) sums to 1
    mean: Array  # (N, G, S) of log k
    covariance: Array  # (N, G, S, S) without the common error


@one_blas_thread
def fit(trial: PopulationTrial) -> Fit:
    """Refines the grid of spreads."""
    points = FEWER if trial.repeated else POINTS
    axes = [np.linspace(np.log(LEAST_SD), np.log(MOST_SD), points)] * 2
    axes.append(np.linspace(0.02, 0.98, points) if trial.repeated else np.ones(1))
    for i in range(ROUNDS):
        found = _on_grid(trial, axes)
        closer = [_closer(axis, share) for axis, share in zip(axes, _shares(found, axes), strict=True)]
        if i == ROUNDS - 1 or all(
            len(a) < 2 or np.ptp(b) > 0.75 * np.ptp(a) for a, b in zip(axes, closer, strict=True)
        ):
            break
        axes = closer
    kept = found.weight > 1e-5 * found.weight.max()
    weight = found.weight[kept] / found.weight[kept].sum()
    return Fit(trial, found.spreads.chosen(kept), weight, found.mean[kept], found.covariance[kept])


def _on_grid(trial: PopulationTrial, axes: list[Array]) -> Fit:
    points = np.array(list(product(*axes, LENGTHS)))
    spreads = Spreads(np.exp(points[:, 0]), np.exp(points[:, 1]), points[:, 3], points[:, 2])
    step = max(1, AT_ONCE // (len(trial.log_k) * len(trial.s) ** 2))
    parts = [_given(trial, spreads.chosen(slice(i, i + step))) for i in range(0, len(points), step)]
    log = np.concatenate([evidence for _, evidence in parts]) + log_prior(spreads, trial)
    weight = np.exp(log - log.max())
    return Fit(
        trial,
        spreads,
        weight / weight.sum(),
        np.concatenate([one.mean for one, _ in parts]),
        np.concatenate([one.covariance for one, _ in parts]),
    )


def _given(trial: PopulationTrial, spreads: Spreads) -> tuple[Means, Array]:
    """Groups' means, and (N,) log evidence."""
    objects = objects_of(trial, spreads)
    spread = lasting_covariance(spreads, trial.s)
    groups = means(objects.mean, objects.covariance + spread, trial.group_of)
    return groups, objects.log_evidence.sum(axis=1) + groups.log_evidence.sum(axis=1)


def objects_of(trial: PopulationTrial, spreads: Spreads) -> Means:
    """Means of each object's recordings; (1, O, ...) if none has two."""
    if not trial.repeated:
        rows = np.argsort(trial.object_of)
        return Means(trial.log_k[None, rows], trial.noise[None, rows], np.zeros((1, trial.objects)))
    passing = (1.0 - spreads.lasting)[:, None, None, None] * covariance(spreads, trial.s)[:, None]
    return means(trial.log_k[None], trial.noise + passing, trial.object_of)


def _shares(found: Fit, axes: list[Array]) -> list[Array]:
    whole = found.weight.reshape([len(axis) for axis in axes] + [len(LENGTHS)])
    return [np.asarray(whole.sum(axis=tuple(j for j in range(whole.ndim) if j != i))) for i in range(len(axes))]


def _closer(axis: Array, share: Array) -> Array:
    before = np.cumsum(share)
    first = max(int(np.searchsorted(before, TAIL)) - 1, 0)
    last = min(int(np.searchsorted(before, 1.0 - TAIL)) + 1, len(axis) - 1)
    return np.linspace(axis[first], axis[last], len(axis))


# The results of a batch as a trial.

TABLES = ("recordings", "curves", "covariances")
ADVICE = (
    "Run the same `onebend batch` again: it writes the tables anew and learns nothing twice. Change groups, names and "
    "recordings in its list"
)
OURS = ("reason", "grade", "doubts", "warnings", "hash", "path", "finished")


@dataclass(frozen=True)
class Named:
    """A trial with names."""

    trial: PopulationTrial
    objects: tuple[str, ...]  # O
    groups: tuple[str, ...]  # G
    identified: Array  # (G, S) share of recordings that identify k
    left_out: tuple[tuple[str, str], ...]  # with reasons


def read_batch(folder: Path, by: str, same: str | None = None) -> Named:
    """Recordings that were learned and are not in doubt, from unchanged tables of `onebend batch`.

    Args:
        by: column of recordings.parquet with the group.
        same: column with the object; None: one object per recording.

    Raises:
        ResultsError: no batch, a changed table, a missing column, an object in two groups, or too few objects.
    """
    _check_unchanged(folder)
    tables = {name: pq.read_table(folder / f"{name}.parquet") for name in TABLES}
    rows = tables["recordings"].to_pylist()
    _check_once(folder, rows)
    used, left_out = _used(rows, [_column(folder, rows, one) for one in (by, same) if one is not None])
    groups_of = {_text(row[same]) if same else row["name"]: _text(row[by]) for row in used}
    for row in used:
        name = _text(row[same]) if same else row["name"]
        if groups_of[name] != _text(row[by]):
            raise ResultsError(
                f"{folder}: the object {quoted(name)} is in the groups {quoted(groups_of[name])} and "
                f"{quoted(_text(row[by]))}. Name its recordings apart, or choose another --by"
            )
    objects, groups = tuple(groups_of), tuple(sorted(set(groups_of.values())))
    if len(objects) == len(groups):
        raise ResultsError(
            f"{folder}: no group has two objects, so nothing tells the spread within groups. Give some group two "
            "objects or more, or choose another --by"
        )
    learned = [row["name"] for row in rows if not row["reason"]]
    kept = np.isin(learned, [row["name"] for row in used])
    s, log_k, covariance, prior, identified = _curves(tables["curves"], tables["covariances"], kept)
    number, place = ({name: i for i, name in enumerate(names)} for names in (objects, groups))
    object_of = np.array([number[_text(row[same]) if same else row["name"]] for row in used])
    group_of = np.array([place[one] for one in groups_of.values()])
    common = max(row["gain_sd"] for row in used)
    alike, shares = (
        np.array([one[group_of[object_of] == i].mean(axis=0) for i in range(len(groups))])
        for one in (prior, identified)
    )
    trial = PopulationTrial(s, log_k, _not_negative(covariance - prior), object_of, group_of, alike, common)
    return Named(trial, objects, groups, shares, left_out)


def _not_negative(matrices: Array) -> Array:
    values, vectors = np.linalg.eigh(0.5 * (matrices + np.swapaxes(matrices, -1, -2)))
    return np.asarray((vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2))


def _check_unchanged(folder: Path) -> None:
    """Raises `ResultsError` where a table is not the one that the folder's summary lists."""
    summary, tables = read_summary(folder), [f"{name}.parquet" for name in TABLES]
    if not any((folder / table).exists() for table in tables):
        raise ResultsError(f"{folder} holds no tables of a batch. Name the folder that `onebend batch` wrote")
    if summary is None or not set(tables) <= set(summary["files"]):
        raise ResultsError(
            f"{folder}: there is no {SUMMARY} that lists the tables of the batch, or it was changed since. {ADVICE}"
        )
    if changed := sorted(set(tables) & set(changed_files(folder))):
        raise ResultsError(f"{folder}: {', '.join(changed)} there is not as `onebend batch` wrote it. {ADVICE}")


def _check_once(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Raises `ResultsError` where a learned recording stands under two names."""
    names = dict[str, str]()
    for row in rows:
        if not row["reason"] and names.setdefault(row["hash"], row["name"]) != row["name"]:
            raise ResultsError(
                f"{folder}: {quoted(names[row['hash']])} and {quoted(row['name'])} are one recording, which counts "
                "once. Leave one out of the batch's list"
            )


def _column(folder: Path, rows: Sequence[Mapping[str, Any]], name: str) -> str:
    known = [one for one in (rows[0] if rows else ()) if one not in OURS]
    if name not in known:
        raise ResultsError(
            f"{folder}: the recordings have no column {quoted(name)}. There are {', '.join(known)}; the columns of the "
            "batch's list are among them"
        )
    return name


def _used(
    rows: Sequence[Mapping[str, Any]], needed: Sequence[str]
) -> tuple[list[Mapping[str, Any]], tuple[tuple[str, str], ...]]:
    used, out = [], []
    for row in rows:
        empty = [name for name in needed if not _text(row[name]) and len({_text(one[name]) for one in rows}) > 1]
        why = row["reason"] or row["doubts"] or (f"no {empty[0]} is stated" if empty else "")
        if why:
            out.append((str(row["name"]), str(why)))
        else:
            used.append(row)
    return used, tuple(out)


def _text(cell: Any) -> str:
    """A name; numbers as people write them."""
    if isinstance(cell, float):
        return "" if np.isnan(cell) else f"{cell:g}"
    return "" if cell is None else str(cell)


def _curves(curves: pa.Table, table: pa.Table, kept: BoolArray) -> tuple[Array, ...]:
    """s (S,), and of the recordings that are `kept` log k (R, S), its covariance and the prior's part of it (R, S, S),
    and whether k is identified (R, S)."""
    columns = [name for name in table.column_names if name.startswith("with_")]
    s = table["s"].to_numpy()[: len(columns)]
    covariance, prior = (
        np.stack([table[f"{head}{name}"].to_numpy() for name in columns], axis=1).reshape(-1, len(s), len(s))[kept]
        for head in ("", "prior_")
    )
    k, identified, places = (
        np.asarray(curves[one].to_numpy(), dtype=float).reshape(len(kept), -1) for one in ("k_N_m", "identified", "s")
    )
    at = [int(np.argmin(np.abs(places[0] - one))) for one in s]
    return s, np.log(k[kept][:, at]), covariance, prior, identified[kept][:, at]


# Mean k(s) of groups, ratios, and k(s) of objects, with 95 % bands.

LOW, HIGH = 0.025, 0.975


@dataclass(frozen=True)
class Curves:
    """M curves of log k (or differences) with 95 % bands at S places."""

    mean: Array  # (M, S)
    low: Array  # (M, S)
    high: Array  # (M, S)


@dataclass(frozen=True)
class Objects:
    """log k(s) of every object, O normals without the common error."""

    mean: Array  # (O, S)
    covariance: Array  # (O, S, S)


def group_means(fit: Fit) -> Curves:
    """With the common error."""
    return _banded(fit, fit.mean, _variances(fit.covariance + fit.trial.alike) + fit.trial.common_sd**2)


def differences(fit: Fit, pairs: list[tuple[int, int]]) -> Curves:
    """First less second group; the common error cancels."""
    first, second = [list(one) for one in zip(*pairs, strict=True)]
    variance = _variances(fit.covariance + fit.trial.alike)
    return _banded(fit, fit.mean[:, first] - fit.mean[:, second], variance[:, first] + variance[:, second])


def _banded(fit: Fit, mean: Array, variance: Array) -> Curves:
    sd = np.sqrt(variance)
    low, high = (quantile(fit.weight, mean, sd, share) for share in (LOW, HIGH))
    return Curves(np.tensordot(fit.weight, mean, axes=1), low, high)


def _variances(covariances: Array) -> Array:
    return np.asarray(np.diagonal(covariances, axis1=-2, axis2=-1))


def within(fit: Fit) -> Array:
    """(S,) RMS sd of log k within groups."""
    return np.asarray(np.sqrt(fit.weight @ _variances(covariance(fit.spreads, fit.trial.s))))


@one_blas_thread
def shrunken(fit: Fit) -> Objects:
    """Each object's log k, drawn towards its group's mean by its uncertainty. Includes the group's shared error."""
    trial, spreads = fit.trial, fit.spreads
    count, places = trial.objects, len(trial.s)
    step = max(1, AT_ONCE // (len(trial.log_k) * places**2))
    total, square = np.zeros((count, places)), np.zeros((count, places, places))
    for first in range(0, len(fit.weight), step):
        rows = slice(first, first + step)
        mean, cov = _drawn(fit, spreads.chosen(rows), rows)
        share = fit.weight[rows]
        total += np.tensordot(share, mean, axes=1)
        square += np.einsum("n,noi,noj->oij", share, mean, mean) + np.tensordot(share, cov, axes=1)
    return Objects(total, square - total[:, :, None] * total[:, None, :] + trial.alike[trial.group_of])


def _drawn(fit: Fit, spreads: Spreads, rows: slice) -> tuple[Array, Array]:
    trial = fit.trial
    objects = objects_of(trial, spreads)
    spread = lasting_covariance(spreads, trial.s)
    precision, _ = inverse(objects.covariance + spread)
    pull = spread @ precision  # towards the object's recordings
    centre, error = fit.mean[rows][:, trial.group_of], fit.covariance[rows][:, trial.group_of]
    mean = centre + np.einsum("noij,noj->noi", pull, objects.mean - centre)
    rest = np.eye(len(trial.s)) - pull
    return mean, rest @ spread + rest @ error @ np.swapaxes(rest, -1, -2)


def banded(objects: Objects, common_sd: float) -> Curves:
    """With the common error."""
    half = 1.959963984540054 * np.sqrt(np.maximum(_variances(objects.covariance), 0.0) + common_sd**2)
    return Curves(objects.mean, objects.mean - half, objects.mean + half)


def half_band(means: Curves, group: int, places: BoolArray) -> float:
    """Half the 95 % band of the group's mean log k, median over the places, or NaN."""
    wide = 0.5 * (means.high[group] - means.low[group])[places]
    return float(np.median(wide)) if len(wide) else float("nan")


# Outliers: each object against the prediction of the others, with the spreads.

ORDERS = 5  # polynomials along the beam: level, slope, bow and two more
FEWEST_OBJECTS = 3  # of a group
FALSE_ALARMS = 0.05  # of groups without a difference, at most
HEAVY = 300  # heaviest grid points


@one_blas_thread
def outliers(fit: Fit) -> tuple[str, ...]:
    """O reasons; empty: no outlier, or too few others.

    Level, slope etc. less their prediction are normal given the spreads, which are weighted without the object. The
    least probability counts ORDERS times the group's size.
    """
    trial, heavy = fit.trial, np.argsort(-fit.weight)[:HEAVY]
    spreads, weight = fit.spreads.chosen(heavy), fit.weight[heavy]
    objects = objects_of(trial, spreads)
    spread = lasting_covariance(spreads, trial.s)
    wide = objects.covariance + spread
    waves = legvander(2.0 * trial.s - 1.0, ORDERS - 1) / len(trial.s)
    reasons = []
    for i, group in enumerate(trial.group_of):
        mates = (trial.group_of == group) & (np.arange(trial.objects) != i)
        if mates.sum() < FEWEST_OBJECTS - 1:
            reasons.append("")
            continue
        precision, _ = inverse(wide[:, mates])
        error, _ = inverse(precision.sum(axis=1))
        centre = np.einsum("nij,nmjk,nmk->ni", error, precision, np.broadcast_to(objects.mean[:, mates],
                           precision.shape[:-1]))  # fmt: skip
        off, scatter = objects.mean[:, i] - centre, wide[:, i] + error
        chance = _chance(off, scatter, weight, waves) * ORDERS * (mates.sum() + 1)
        reasons.append(_reason(chance, weight @ off, trial.s) if chance.min() < FALSE_ALARMS else "")
    return tuple(reasons)


def _chance(off: Array, scatter: Array, weight: Array, waves: Array) -> Array:
    """(ORDERS,) two-sided probabilities."""
    inner, logs = inverse(scatter)
    log_density = -0.5 * (logs + np.einsum("ni,nij,nj->n", off, inner, off))
    log = np.log(weight) - log_density  # weights without the object
    without = np.exp(log - log.max())
    sd = np.sqrt(np.einsum("si,nst,ti->ni", waves, scatter, waves))
    tails = 2.0 * np.exp(log_ndtr(-np.abs(off @ waves) / sd))
    return np.asarray(without @ tails / without.sum())


def _reason(chance: Array, off: Array, s: Array) -> str:
    least = f"p = {min(float(chance.min()), 1.0):.1g}"
    if int(np.argmin(chance)) == 0:
        return f"k is {np.exp(off.mean()):.2g} times that of the others ({least})"
    beside = off - off.mean()
    at = int(np.argmax(np.abs(beside)))
    return f"the shape of k(s) is {np.exp(beside[at]):.2g} times that of the others at s = {s[at]:.2g} ({least})"


# Shares of the variance between groups, and of the object.

BAND = (0.5, 0.025, 0.975)
FEWEST_GROUPS = 3  # for a spread between groups
HEAVY_SHARES = 200  # heaviest grid points
STEPS = np.linspace(0.0, 0.99, 34)  # of the share between groups


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval; NaN if not identifiable."""

    value: float  # median
    low: float
    high: float


UNKNOWN = Estimate(np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class Shares:
    """Of log k between objects."""

    level_sd: Estimate  # within groups, mean along the beam
    shape_sd: Estimate  # within groups, RMS
    repeatability: Estimate  # share of the variance within groups that stays with the object
    between: Estimate  # share of all variance (intraclass correlation, heritability)
    between_sd: Estimate  # of the groups' means, RMS


def shares(fit: Fit) -> Shares:
    """From the posterior."""
    spreads, weight = fit.spreads, fit.weight
    lasting = np.sqrt(spreads.lasting)
    between, between_sd = _between(fit) if fit.trial.groups >= FEWEST_GROUPS else (UNKNOWN, UNKNOWN)
    return Shares(
        _estimate(lasting * spreads.level_sd, weight),
        _estimate(lasting * spreads.shape_sd, weight),
        _estimate(spreads.lasting, weight) if fit.trial.repeated else UNKNOWN,
        between,
        between_sd,
    )


def _estimate(values: Array, weight: Array) -> Estimate:
    return Estimate(*weighted_quantiles(values, weight, BAND))


@one_blas_thread
def _between(fit: Fit) -> tuple[Estimate, Estimate]:
    """Groups' means scatter with h / (1 - h) of the covariance within groups; h is flat."""
    heavy = np.argsort(-fit.weight)[:HEAVY_SHARES]
    spreads = fit.spreads.chosen(heavy)
    within = lasting_covariance(spreads, fit.trial.s)
    log, every = [], np.zeros(fit.trial.groups, dtype=int)
    for share in STEPS:
        scatter = share / (1.0 - share) * within
        log.append(means(fit.mean[heavy], fit.covariance[heavy] + scatter, every).log_evidence[:, 0])
    joint = np.array(log) + np.log(fit.weight[heavy])
    weight = np.exp(joint - joint.max())
    rms = np.sqrt(np.mean(_variances(within[:, 0]), axis=1))
    sd = np.sqrt(STEPS / (1.0 - STEPS))[:, None] * rms
    return _estimate(STEPS, weight.sum(axis=1)), _estimate(sd.ravel(), weight.ravel())
