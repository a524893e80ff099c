"""Which push to make next, and what a push tells of k(s)."""

from __future__ import annotations

from onebend.learning.design.candidates import Limits
from onebend.learning.design.identifiability import information, information_along
from onebend.learning.design.instruments import ForceDoubt, Instruments, PlannedPush, instruments_of
from onebend.learning.design.planning import PlanSettings, after_push, plan
from onebend.learning.design.proposals import Plan, Proposal, Quality
from onebend.results.model import load_instruments

__all__ = [
    "ForceDoubt",
    "Instruments",
    "Limits",
    "Plan",
    "PlanSettings",
    "PlannedPush",
    "Proposal",
    "Quality",
    "after_push",
    "information",
    "information_along",
    "instruments_of",
    "load_instruments",
    "plan",
]
