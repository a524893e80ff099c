"""A push rehearsed before it is filmed: how well k(s) would come out, and what to change."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.forecast.advice import SetupChange as SetupChange
    from onebend.forecast.prediction import BudgetEntry as BudgetEntry
    from onebend.forecast.prediction import PredictedBand as PredictedBand
    from onebend.forecast.rehearsal import Obtained as Obtained
    from onebend.forecast.rehearsal import Rehearsal as Rehearsal
    from onebend.forecast.rehearsal import rehearse as rehearse
    from onebend.forecast.runs import SimulatedRun as SimulatedRun
    from onebend.forecast.sensed_force import SensedForce as SensedForce
    from onebend.forecast.sensed_force import SensedTags as SensedTags
    from onebend.forecast.sensed_force import drawn_tags as drawn_tags
    from onebend.forecast.sensed_force import felt_by as felt_by
    from onebend.forecast.setup import KnownBeam as KnownBeam
    from onebend.forecast.setup import Setup as Setup
    from onebend.forecast.setup import known_beam as known_beam
    from onebend.forecast.setup import setup_of as setup_of
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.forecast.advice": "SetupChange",
            "onebend.forecast.prediction": "BudgetEntry PredictedBand",
            "onebend.forecast.rehearsal": "Obtained Rehearsal rehearse",
            "onebend.forecast.runs": "SimulatedRun",
            "onebend.forecast.sensed_force": "SensedForce SensedTags drawn_tags felt_by",
            "onebend.forecast.setup": "KnownBeam Setup known_beam setup_of",
        },
    )
