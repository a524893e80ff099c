"""How large an allowance is whose size nobody knows: the evidence chooses it (automatic relevance determination)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from onebend.learning.allowances.allowance import Sizes
from onebend.learning.inference.block_root import beside, unit_root
from onebend.learning.inference.fit_problem import Hyperparameters, prior
from onebend.learning.inference.hyperparameters import Evidence
from onebend.learning.inference.information_form import InformationForm, in_z
from onebend.learning.inference.joint import coupled, marginal, solved
from onebend.learning.model.parameters import Block
from onebend.records import Array, IntArray

FACTORS = np.exp(np.linspace(np.log(0.02), np.log(10.0), 120))  # that are tried


def choose_sizes(evidence: Evidence, start: Hyperparameters) -> Sizes:
    """The factor of greatest evidence for every allowance that is `sized`, one after the other, under a half-Cauchy
    prior of scale one."""
    sizes = dict(start.sizes)
    names = {a.name for recording in evidence.problem.recordings for a in recording.allowances if a.sized}
    for name in sorted(names):
        log_density = size_density(evidence, replace(start, sizes=sizes), name)
        sizes[name] = float(FACTORS[int(np.argmax(log_density))])
    return sizes


def size_density(evidence: Evidence, start: Hyperparameters, name: str) -> Array:
    """(FACTORS,) log of the posterior density of the log of one allowance's factor, but for a constant, all else at
    `start`."""
    layout, before = evidence.problem.layout, prior(evidence.problem, start)
    where = [_stands(inside, name, part.start) for inside, part in zip(layout.free_blocks, layout.parts, strict=True)]
    sd = [before.roots[i].sd[index] / start.sizes.get(name, 1.0) for i, index in enumerate(where)]
    if len(where[0]):
        told = marginal(solved(evidence.data, before).left, before.mean[layout.parts[0]], before.roots[0], where[0])
        return log_density_of([_scaled(told, 0, sd[0])], 0)
    data, some = coupled(evidence.data, before, where[1:])
    couple, root = some.parts[0].stop, some.roots[0]
    forms = []
    for form, s in zip(data.forms, sd[1:], strict=True):
        mean = np.concatenate([some.mean[:couple], np.zeros(len(s))])
        forms.append(_scaled(in_z(form, mean, beside(root, unit_root(len(s)))), couple, s))
    return log_density_of(forms, couple)


def likely_sizes(evidence: Evidence, start: Hyperparameters, name: str, count: int) -> Array:
    """(count,) factors on one allowance that are about equally probable: middles of parts of its posterior."""
    log_density = size_density(evidence, start, name)
    share = np.exp(log_density - np.max(log_density))
    below = (np.cumsum(share) - 0.5 * share) / np.sum(share)
    return np.asarray(np.exp(np.interp((np.arange(count) + 0.5) / count, below, np.log(FACTORS))))


def _stands(blocks: Sequence[Block], name: str, start: int) -> IntArray:
    """(n,) where blocks of a name stand in a part of the parameters that begins at `start`."""
    return np.concatenate(
        [
            np.zeros(0, dtype=np.int64),
            *(np.arange(b.where.start, b.where.stop) - start for b in blocks if b.name == name),
        ]
    )


def _scaled(form: InformationForm, kept: int, sd: Array) -> InformationForm:
    """A form in units of sd (n,) of all but its first parameters."""
    scale = np.concatenate([np.ones(kept), sd])
    return InformationForm(scale[:, None] * form.matrix * scale, scale * form.vector)


def log_density_of(forms: Sequence[InformationForm], couple: int) -> Array:
    """(FACTORS,) log of the posterior density of the log of a factor f, for coefficients b of prior covariance `f^2 I`.

    Each form is over `couple` shared parameters of covariance one, and over coefficients of its own. With all
    integrated out, `2 log p = sum (f^2 b' (I + f^2 H)^-1 b - log det(I + f^2 H)) + c' (I + S)^-1 c - log det(I + S)`,
    H and b of each form's own coefficients, S and c what is left of the shared ones.
    """
    variance = FACTORS[:, None] ** 2
    log_density = np.log(FACTORS) - np.log1p(FACTORS**2)  # half-Cauchy, of the log of the factor
    left, right = np.tile(np.eye(couple), (len(FACTORS), 1, 1)), np.zeros((len(FACTORS), couple))
    for form in forms:
        values, vectors = np.linalg.eigh(form.matrix[couple:, couple:])
        values = np.maximum(values, 0.0)
        across, b = vectors.T @ form.matrix[couple:, :couple], vectors.T @ form.vector[couple:]
        weights = variance / (1.0 + variance * values)  # (factors, n)
        log_density += 0.5 * (weights @ b**2 - np.sum(np.log1p(variance * values), axis=1))
        if couple:
            left += form.matrix[:couple, :couple] - across.T @ (weights[..., None] * across)
            right += form.vector[:couple] - (weights * b) @ across
    if couple:
        root = np.linalg.cholesky(left)
        white = np.linalg.solve(root, right[..., None])[..., 0]
        log_density += 0.5 * np.sum(white**2, axis=1) - np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return np.asarray(log_density)
