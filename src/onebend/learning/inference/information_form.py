"""A normal density, or a likelihood to second order, by its information matrix and vector.

Those of independent data add up, and what is known of some parameters with all others integrated out has this form too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from onebend.learning.inference.block_root import BlockRoot
from onebend.records import Array


@dataclass(frozen=True)
class InformationForm:
    """What is known of n parameters: `-2 log p = x' H x - 2 b' x + c + 2 log_noise`, but for a common constant."""

    matrix: Array  # (n, n) H
    vector: Array  # (n,) b
    constant: float = 0.0  # c
    log_noise: float = 0.0  # sum of the logs of the noise's sd
    weight: float = 1.0  # of this density in a mixture; the weights sum to one


def total(parts: Sequence[InformationForm]) -> InformationForm:
    """The log likelihood of independent data together."""
    first, *others = parts
    return InformationForm(
        sum((p.matrix for p in others), first.matrix),
        sum((p.vector for p in others), first.vector),
        sum(p.constant for p in parts),
        sum(p.log_noise for p in parts),
    )


def in_z(form: InformationForm, mean: Array, root: BlockRoot) -> InformationForm:
    """The same of z, where the parameters are `mean + L z` with a root L."""
    gap = form.vector - form.matrix @ mean
    constant = form.constant - float((form.vector + gap) @ mean)
    return replace(form, matrix=root.around(form.matrix), vector=root.transposed_times(gap), constant=constant)
