"""A push rehearsed before it is filmed: how well k(s) would come out, and what to change."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.forecast.advice import Change as Change
    from onebend.forecast.prediction import Doubt as Doubt
    from onebend.forecast.prediction import Predicted as Predicted
    from onebend.forecast.rehearsal import Obtained as Obtained
    from onebend.forecast.rehearsal import Rehearsal as Rehearsal
    from onebend.forecast.rehearsal import rehearse as rehearse
    from onebend.forecast.runs import Run as Run
    from onebend.forecast.setup import Known as Known
    from onebend.forecast.setup import Setup as Setup
    from onebend.forecast.setup import known_beam as known_beam
    from onebend.forecast.setup import setup_of as setup_of
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.forecast.advice": "Change",
            "onebend.forecast.prediction": "Doubt Predicted",
            "onebend.forecast.rehearsal": "Obtained Rehearsal rehearse",
            "onebend.forecast.runs": "Run",
            "onebend.forecast.setup": "Known Setup known_beam setup_of",
        },
    )
