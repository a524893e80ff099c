"""Roots of prior covariances: a diagonal, with triangular blocks where parameters depend on each other beforehand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from onebend.records import Array, IntArray


@dataclass(frozen=True)
class BlockRoot:
    """(n, n) lower triangular L: diagonal but for some blocks."""

    sd: Array  # (n,) the diagonal; of no meaning where a block stands
    blocks: tuple[tuple[IntArray, Array], ...] = ()  # which rows and columns, and (m, m) lower triangular

    @cached_property
    def unit(self) -> bool:
        """Whether L is the identity."""
        return not self.blocks and bool(np.all(self.sd == 1.0))

    def times(self, z: Array) -> Array:
        """(n, ...) `L z`."""
        out = (self.sd * z.T).T
        for where, root in self.blocks:
            rows = _rows(where)
            out[rows] = root @ z[rows]
        return out

    def transposed_times(self, v: Array) -> Array:
        """(n, ...) `L' v`; v itself where L is the identity."""
        if self.unit:
            return v
        out = (self.sd * v.T).T
        for where, root in self.blocks:
            rows = _rows(where)
            out[rows] = root.T @ v[rows]
        return out

    def solve(self, x: Array) -> Array:
        """(n, ...) `L^-1 x`."""
        out = np.array((x.T / self.sd).T)
        for where, root in self.blocks:
            out[where] = solve_triangular(root, x[where], lower=True, check_finite=False)
        return out

    def around(self, matrix: Array) -> Array:
        """(n, n) `L' M L`, a new array."""
        if self.unit:
            return matrix.copy()
        half = np.ascontiguousarray(self.transposed_times(matrix).T)  # rows in one piece are read faster
        return self.transposed_times(half).T

    def take(self, index: IntArray) -> BlockRoot:
        """The root of some parameters (m,), of a block all or none."""
        place = np.full(len(self.sd), -1)
        place[index] = np.arange(len(index))
        return BlockRoot(self.sd[index], tuple((place[i], root) for i, root in self.blocks if np.all(place[i] >= 0)))

    def dense(self) -> Array:
        """(n, n) L."""
        return self.times(np.eye(len(self.sd)))


def _rows(where: IntArray) -> IntArray | slice:
    """Evenly spaced rows (m,) as a slice, which reads them in place."""
    if len(where) < 2:
        return where
    first, last, step = int(where[0]), int(where[-1]), int(where[1] - where[0])
    return slice(first, last + 1, step) if step > 0 and np.all(np.diff(where) == step) else where


def beside(first: BlockRoot, second: BlockRoot) -> BlockRoot:
    """The root of two independent groups of parameters together."""
    later = tuple((index + len(first.sd), root) for index, root in second.blocks)
    return BlockRoot(np.concatenate([first.sd, second.sd]), (*first.blocks, *later))


def unit_root(count: int) -> BlockRoot:
    """The root of parameters (n,) that are their own z."""
    return BlockRoot(np.ones(count))
