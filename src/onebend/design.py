"""Which push to make next, and what a push tells of k(s)."""

from __future__ import annotations

from onebend.learning.design.candidates import Limits
from onebend.learning.design.identifiability import information, information_along
from onebend.learning.design.instruments import Bench, ForceDoubt, Push, bench_of
from onebend.learning.design.planning import PlanSettings, plan
from onebend.learning.design.proposals import Plan, Proposal, Quality

__all__ = [
    "Bench",
    "ForceDoubt",
    "Limits",
    "Plan",
    "PlanSettings",
    "Proposal",
    "Push",
    "Quality",
    "bench_of",
    "information",
    "information_along",
    "plan",
]
