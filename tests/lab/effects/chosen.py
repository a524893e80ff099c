"""Benches with a choice of effects."""

from __future__ import annotations

from dataclasses import replace

from onebend.lab.random_bench import EFFECTS, LABORATORY, EffectRanges


def only(*names: str) -> EffectRanges:
    """Only the named effects, with certainty."""
    assert set(names) <= set(EFFECTS)
    chance = {name: replace(getattr(LABORATORY, name), probability=float(name in names)) for name in EFFECTS}
    return EffectRanges(**chance)
