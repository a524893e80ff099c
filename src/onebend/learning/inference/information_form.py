"""A normal density by its information matrix and vector; sums of them join what independent data say."""

from __future__ import annotations

from dataclasses import dataclass

from onebend.records import Array


@dataclass(frozen=True)
class InformationForm:
    """What is known of parameters x, all others integrated out: `-2 log p = x' H x - 2 b' x + const`."""

    matrix: Array  # (n, n) H
    vector: Array  # (n,) b
    weight: float = 1.0  # of this density in a mixture, whose weights sum to one
