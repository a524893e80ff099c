"""`report.html` of a population."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from onebend.escaping import one_line
from onebend.population.outcome import PopulationOutcome
from onebend.population.shares import Estimate
from onebend.population.tables import TABLES
from onebend.report.page.template import render
from onebend.report.wording import UNKNOWN, significant

SPREAD = {
    "level_sd": ("within groups, of the level of k", True),
    "shape_sd": ("within groups, of the shape of k(s)", True),
    "repeatability": ("repeatability: share of the variance within groups that stays with the object", False),
    "between": ("share of all variance between objects that lies between groups (intraclass correlation)", False),
    "between_sd": ("between the groups' means", True),
}
MOST_JUDGED = 200  # rows of objects on the page; the table has all


def page(outcome: PopulationOutcome, figures: Mapping[str, bytes], *, name: str, version: str) -> str:
    """The page as HTML, which carries everything in itself."""
    named = outcome.named
    content = {
        "version": version,
        "title": one_line(f"Population {name}"),
        "cards": _cards(outcome),
        "group_heads": ("group", "objects", "recordings", "half band of the mean", "objects for the wished band"),
        "group_rows": _group_rows(outcome),
        "spread_heads": ("", "value", "95 % from", "to"),
        "spread_rows": [_spread_row(*SPREAD[key], value) for key, value in vars(outcome.shares).items()],
        "outliers": [(one_line(one), why) for one, why in zip(named.objects, outcome.outliers, strict=True) if why],
        "tolerance": judged_words(outcome),
        "judged_heads": ("object", "group", "probability inside", ""),
        "judged_rows": _judged_rows(outcome),
        "ratios": bool(outcome.pairs),
        "needed": f"For a half band of {percent(outcome.setting.wished)} of k, the median along the beam.",
        "left_out": [(one_line(one), one_line(why)) for one, why in named.left_out],
        "files": list(TABLES.items()),
        "data": "{}",
    }
    return render("onebend.population", "page.html", figures, content)


def percent(share: float) -> str:
    """A share in percent; a dash where it is not known."""
    return f"{significant(100.0 * share)} %" if np.isfinite(share) else UNKNOWN


def count_words(number: float) -> str:
    """A number of objects."""
    return f"{number:.0f} objects" if np.isfinite(number) else "no number of them"


def group_name(name: str) -> str:
    """A group's name on a screen or page."""
    return one_line(name) or "all"


def judged_words(outcome: PopulationOutcome) -> str:
    """What passes, and the errors to be expected; empty where no tolerance was given."""
    judged = outcome.judgement
    if judged is None:
        return ""
    return (
        f"{int(judged.passed.sum())} of {len(judged.inside)} objects pass: k(s) lies inside everywhere with a "
        f"probability of {significant(judged.passes)} or more. To be expected: {percent(judged.false_passes)} of those "
        f"that pass lie outside, {percent(judged.false_fails)} of those that fail lie inside."
    )


def _cards(outcome: PopulationOutcome) -> list[dict[str, str]]:
    trial = outcome.named.trial
    far = sum(bool(why) for why in outcome.outliers)
    level = outcome.shares.level_sd
    return [
        {"what": "objects", "value": str(trial.objects), "note": f"in {trial.groups} groups"},
        {"what": "recordings", "value": str(len(trial.log_k)), "note": f"{len(outcome.named.left_out)} left out"},
        {
            "what": "spread of k within groups",
            "value": percent(float(np.expm1(level.value))),
            "note": "sd of the level",
        },
        {"what": "unlike the others", "value": str(far), "note": "objects"},
    ]


def _group_rows(outcome: PopulationOutcome) -> list[tuple[str, ...]]:
    trial = outcome.named.trial
    return [
        (
            group_name(name),
            str(int(np.sum(trial.group_of == i))),
            str(int(np.sum(trial.group_of[trial.object_of] == i))),
            f"± {percent(float(np.expm1(outcome.half[i])))}",
            count_words(outcome.needed[i]),
        )
        for i, name in enumerate(outcome.named.groups)
    ]


def _spread_row(what: str, of_log_k: bool, one: Estimate) -> tuple[str, ...]:
    values = np.array([one.value, one.low, one.high])
    return (what, *(percent(float(value)) for value in (np.expm1(values) if of_log_k else values)))


def _judged_rows(outcome: PopulationOutcome) -> list[tuple[Any, ...]]:
    judged, named = outcome.judgement, outcome.named
    if judged is None:
        return []
    rows = zip(named.objects, named.trial.group_of, judged.inside, judged.passed, strict=True)
    found = [
        (one_line(name), group_name(named.groups[i]), significant(inside), "passes" if passed else "fails")
        for name, i, inside, passed in rows
    ]
    return found[:MOST_JUDGED]
