"""Results of `onebend population`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from onebend.files.publish import headed
from onebend.files.single_file import as_csv, as_parquet
from onebend.many import population as model
from onebend.options import option
from onebend.progress import Progress, Silent
from onebend.records import Array, BoolArray
from onebend.report.page import render
from onebend.report.pictures import Draw, Pictures, draw
from onebend.report.sentences import UNKNOWN, counted, significant
from onebend.report.style import INK, MUTED, ORANGE, blank, hue_of, styled
from onebend.text_files import figure_text, one_line

MOST_COMPARED = 12  # groups up to which all pairs are compared; of more, each with the first


@dataclass(frozen=True)
class PopulationSettings:
    by: str = option("--by", "group", metavar="COLUMN")
    same: str | None = option("--object", None, metavar="COLUMN")


@dataclass(frozen=True)
class PopulationOutcome:
    setting: PopulationSettings
    named: model.Named
    means: model.Curves  # of log k, G
    told: BoolArray  # (G, S) identified by at least half of the recordings
    pairs: tuple[tuple[int, int], ...]  # of groups
    ratios: model.Curves  # of the logarithm, per pair
    curves: model.Curves  # of log k, O
    within: Array  # (S,) of log k
    shares: model.Shares
    outliers: tuple[str, ...]  # O reasons
    half: tuple[float, ...]  # G half-widths of log k, median over `told`


def population(named: model.Named, setting: PopulationSettings = PopulationSettings()) -> PopulationOutcome:
    """The posterior of means, spreads and objects."""
    trial, found = named.trial, model.fit(named.trial)
    means, told = model.group_means(found), named.identified >= 0.5
    groups = range(trial.groups)
    pairs = list(combinations(groups, 2))
    if trial.groups > MOST_COMPARED:
        pairs = [(i, 0) for i in groups if i]
    return PopulationOutcome(
        setting=setting,
        named=named,
        means=means,
        told=told,
        pairs=tuple(pairs),
        ratios=model.differences(found, pairs) if pairs else model.Curves(*[np.zeros((0, len(trial.s)))] * 3),
        curves=model.banded(model.shrunken(found), trial.common_sd),
        within=model.within(found),
        shares=model.shares(found),
        outliers=model.outliers(found),
        half=tuple(model.half_band(means, i, told[i]) for i in groups),
    )


# Tables, each as Parquet and CSV.

TABLES = {
    "groups": "one row per group: number of objects, band of the mean",
    "means": "one row per group and place: mean k(s) with its 95 % band",
    "ratios": "one row per pair of groups and place: ratio of the means with its 95 % band",
    "spread": "one row per statistic: spread within and between groups, repeatability, with 95 % intervals",
    "objects": "one row per object: k at five places, why it is an outlier",
    "curves": "one row per object and place: k(s), drawn towards the group's mean, with its 95 % band",
    "left_out": "one row per excluded recording, with the reason",
}
AT = (0.0, 0.25, 0.5, 0.75, 1.0)  # s, of k in the table of objects


def tables(outcome: PopulationOutcome) -> dict[str, pa.Table]:
    made = (_groups, _means, _ratios, _spread, _objects, _curves, _left_out)
    return {name: pa.table(one(outcome)) for name, one in zip(TABLES, made, strict=True)}


def _groups(outcome: PopulationOutcome) -> dict[str, Any]:
    trial = outcome.named.trial
    return {
        "group": _texts(outcome.named.groups),
        "objects": np.bincount(trial.group_of),
        "recordings": np.bincount(trial.group_of[trial.object_of]),
        "half_band": np.expm1(outcome.half),
    }


def _means(outcome: PopulationOutcome) -> dict[str, Any]:
    return {
        "group": _each(outcome.named.groups, outcome),
        **_curve(outcome.means, outcome, "k", "_N_m"),
        "identified": outcome.told.ravel(),
        "within_sd": np.tile(outcome.within, outcome.named.trial.groups),
    }


def _ratios(outcome: PopulationOutcome) -> dict[str, Any]:
    groups = outcome.named.groups
    return {
        "group": _each([groups[i] for i, _ in outcome.pairs], outcome),
        "over": _each([groups[j] for _, j in outcome.pairs], outcome),
        **_curve(outcome.ratios, outcome, "ratio", ""),
    }


def _spread(outcome: PopulationOutcome) -> dict[str, Any]:
    found = {one.name: getattr(outcome.shares, one.name) for one in fields(model.Shares)}
    return {
        "quantity": _texts(found),
        **{name: np.array([getattr(one, name) for one in found.values()]) for name in ("value", "low", "high")},
    }


def _objects(outcome: PopulationOutcome) -> dict[str, Any]:
    named, curves = outcome.named, outcome.curves
    trial = named.trial
    columns: dict[str, Any] = {
        "object": _texts(named.objects),
        "group": _texts([named.groups[i] for i in trial.group_of]),
        "recordings": np.bincount(trial.object_of),
    }
    for s in AT:
        i = int(np.argmin(np.abs(trial.s - s)))
        for name, one in (("k", curves.mean), ("k_lo", curves.low), ("k_hi", curves.high)):
            columns[f"{name}_at_{s:g}_N_m"] = np.exp(one[:, i])
    return columns | {"outlier": _texts(outcome.outliers)}


def _curves(outcome: PopulationOutcome) -> dict[str, Any]:
    named = outcome.named
    return {
        "object": _each(named.objects, outcome),
        "group": _each([named.groups[i] for i in named.trial.group_of], outcome),
        **_curve(outcome.curves, outcome, "k", "_N_m"),
    }


def _left_out(outcome: PopulationOutcome) -> dict[str, Any]:
    rows = outcome.named.left_out
    return {"recording": _texts([name for name, _ in rows]), "reason": _texts([why for _, why in rows])}


def _texts(words: Any) -> pa.Array:
    return pa.array(list(words), pa.string())


def _each(names: Any, outcome: PopulationOutcome) -> pa.Array:
    return _texts(name for name in names for _ in outcome.named.trial.s)


def _curve(curves: model.Curves, outcome: PopulationOutcome, name: str, unit: str) -> dict[str, Any]:
    return {
        "s": np.tile(outcome.named.trial.s, len(curves.mean)),
        f"{name}{unit}": np.exp(curves.mean).ravel(),
        f"{name}_lo{unit}": np.exp(curves.low).ravel(),
        f"{name}_hi{unit}": np.exp(curves.high).ravel(),
    }


A_ROW = 3  # panels per row
MOST = 24  # panels


def draw_figures(outcome: PopulationOutcome, *, progress: Progress = Silent()) -> Pictures:
    wanted: dict[str, Draw] = {"means": partial(means, outcome), "groups": partial(panels, outcome)}
    if outcome.pairs:
        wanted["ratios"] = partial(ratios, outcome)
    return draw(wanted, progress)


@styled
def means(outcome: PopulationOutcome) -> Figure:
    """Groups' means with bands."""
    figure, (axes,) = blank(3.8)
    s, count = outcome.named.trial.s, min(len(outcome.named.groups), MOST)
    for i in range(count):
        _banded(axes, s, outcome.means, i, color=hue_of(i, count), label=outcome.named.groups[i] or "all")
    axes.set(xlabel="s", ylabel="k(s) [N m]", yscale="log")
    axes.legend(ncols=4)
    return figure


def _banded(axes: Axes, s: Array, curves: model.Curves, i: int, *, color: str, label: str) -> None:
    axes.fill_between(s, np.exp(curves.low[i]), np.exp(curves.high[i]), color=color, alpha=0.2, linewidth=0)
    axes.plot(s, np.exp(curves.mean[i]), color=color, label=figure_text(label))


@styled
def panels(outcome: PopulationOutcome) -> Figure:
    """Per group: objects, outliers, mean."""
    trial, count = outcome.named.trial, min(len(outcome.named.groups), MOST)
    rows = -(-count // A_ROW)
    figure, axes = blank(2.4 * rows, rows, min(count, A_ROW), sharex=True, sharey=True)
    for i, panel in enumerate(axes):
        if i >= count:
            panel.set_axis_off()
            continue
        for one in np.flatnonzero(trial.group_of == i):
            far = bool(outcome.outliers[one])
            panel.plot(trial.s, np.exp(outcome.curves.mean[one]), color=ORANGE if far else MUTED, linewidth=0.8)
        panel.plot(trial.s, np.exp(outcome.means.mean[i]), color=hue_of(i, count))
        panel.set(yscale="log", title=figure_text(outcome.named.groups[i] or "all"))
    axes[0].set_ylabel("k(s) [N m]")
    return figure


@styled
def ratios(outcome: PopulationOutcome) -> Figure:
    """For the first pairs."""
    figure, (axes,) = blank(3.4)
    s, shown = outcome.named.trial.s, outcome.pairs[:6]
    for i, (one, other) in enumerate(shown):
        name = f"{outcome.named.groups[one]} / {outcome.named.groups[other]}"
        _banded(axes, s, outcome.ratios, i, color=hue_of(i), label=name)
    axes.axhline(1.0, color=INK, linewidth=1.0)
    axes.set(xlabel="s", ylabel="ratio of k(s)", yscale="log")
    axes.legend(ncols=3)
    return figure


SPREAD = {
    "level_sd": ("within groups, of the level of k", True),
    "shape_sd": ("within groups, of the shape of k(s)", True),
    "repeatability": ("repeatability: share of the variance within groups that stays with the object", False),
    "between": ("share of all variance between objects that lies between groups (intraclass correlation)", False),
    "between_sd": ("between the groups' means", True),
}


def page(outcome: PopulationOutcome, figures: Mapping[str, bytes], *, name: str) -> str:
    named = outcome.named
    content = {
        "title": one_line(f"Population {name}"),
        "cards": _cards(outcome),
        "group_heads": ("group", "objects", "recordings", "half-width of the mean"),
        "group_rows": [
            (group_name(one["group"]), str(one["objects"]), str(one["recordings"]), f"± {percent(one['half_band'])}")
            for one in group_rows(outcome)
        ],
        "spread_heads": ("", "value", "95 % from", "to"),
        "spread_rows": [(what, *map(percent, values)) for what, values in spread_rows(outcome)],
        "outliers": [(one_line(one), why) for one, why in zip(named.objects, outcome.outliers, strict=True) if why],
        "ratios": bool(outcome.pairs),
        "left_out": [(one_line(one), one_line(why)) for one, why in named.left_out],
        "files": list(TABLES.items()),
        "data": "{}",
    }
    return render("onebend.many", "population.html", figures, content)


def percent(share: float) -> str:
    """A dash if unknown."""
    return f"{significant(100.0 * share)} %" if np.isfinite(share) else UNKNOWN


def group_name(name: str) -> str:
    return one_line(name) or "all"


def _cards(outcome: PopulationOutcome) -> list[tuple[str, str, str]]:
    trial = outcome.named.trial
    far = sum(bool(why) for why in outcome.outliers)
    spread = percent(float(np.expm1(outcome.shares.level_sd.value)))
    return [
        ("objects", str(trial.objects), f"in {counted(trial.groups, 'group')}"),
        ("recordings", str(len(trial.log_k)), f"{len(outcome.named.left_out)} left out"),
        ("spread of k within groups", spread, "sd of the level"),
        ("unlike the others", str(far), "objects"),
    ]


def group_rows(outcome: PopulationOutcome) -> list[dict[str, Any]]:
    return [dict(one) for one in pa.table(_groups(outcome)).to_pylist()]


def spread_rows(outcome: PopulationOutcome) -> list[tuple[str, list[float]]]:
    rows = []
    for key, (what, of_log_k) in SPREAD.items():
        one: model.Estimate = getattr(outcome.shares, key)
        values = np.array([one.value, one.low, one.high])
        rows.append((what, (np.expm1(values) if of_log_k else values).tolist()))
    return rows


POPULATION_FORMAT = "onebend-population-1"


def summary_of(outcome: PopulationOutcome) -> dict[str, Any]:
    named, told = outcome.named, ("group", "objects", "half_band")
    return headed(POPULATION_FORMAT) | {
        "by": outcome.setting.by,
        "object": outcome.setting.same,
        "groups": [{name: row[name] for name in told} for row in group_rows(outcome)],
        "spread": asdict(outcome.shares),
        "outliers": [
            {"object": name, "reason": why} for name, why in zip(named.objects, outcome.outliers, strict=True) if why
        ],
        "left_out": [{"recording": name, "reason": why} for name, why in named.left_out],
    }


def write_report(folder: Path, outcome: PopulationOutcome, figures: Mapping[str, bytes], *, name: str) -> None:
    """`figures`: PNGs by name."""
    for key, table in tables(outcome).items():
        (folder / f"{key}.parquet").write_bytes(as_parquet(table))
        (folder / f"{key}.csv").write_bytes(as_csv(table))
    (folder / "report.html").write_text(page(outcome, figures, name=name), encoding="utf-8")
