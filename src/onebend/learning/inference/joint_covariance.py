"""Covariance of all parameters of several recordings of one beam, without that of every pair of recordings.

Exact among the shared parameters and the own ones of one recording. Given the shared ones, the own parameters of two
recordings are independent, which is exact at fixed hyperparameters: their covariance follows from that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.records import Array, IntArray

_MOST_TOLD = 1e-9  # of the largest eigenvalue of correlations: directions below are fixed


@dataclass(frozen=True)
class Conditioning:
    """What numbers k, correlated with parameters b, would be, were these known."""

    explained: Array  # (S,) part of the variance of k
    change: Array  # (S,) of k, where b goes by `away`
    chi_squared: float  # of `away`


@dataclass(frozen=True)
class JointCovariance:
    """(P, P), by recording."""

    shared: int  # parameters that all recordings share; they come first
    pairs: Sequence[Array]  # (n, n) of each recording: of the shared parameters and its own
    parts: tuple[slice, ...]  # where the shared parameters stand, and those of each recording

    @property
    def diagonal(self) -> Array:
        """(P,)."""
        n = self.shared
        return np.concatenate([np.diag(self.of_shared), *(np.diag(pair)[n:] for pair in self.pairs)])

    @property
    def of_shared(self) -> Array:
        """(n, n) of the shared parameters."""
        return self.pairs[0][: self.shared, : self.shared]

    def among(self, where: slice) -> Array:
        """(n, n) of parameters that stand in one part."""
        pair, inside = self._place(where)
        return self.pairs[pair][inside, inside]

    def shared_with(self, where: slice) -> Array:
        """(n, m) of the shared parameters with some that stand in one part."""
        pair, inside = self._place(where)
        return self.pairs[pair][: self.shared, inside]

    def with_shared(self, index: IntArray | slice) -> Array:
        """(P, n) of all parameters with some of the shared ones."""
        own = [pair[self.shared :, : self.shared][:, index] for pair in self.pairs]
        return np.concatenate([self.of_shared[:, index], *own])

    def of_functionals(self, rows: Sequence[tuple[slice, Array]]) -> Array:
        """(N, N) of linear functions of parameters: (r, n) weights of those that stand in one slice, N rows in all."""
        counts = [len(weights) for _, weights in rows]
        first = np.concatenate([[0], np.cumsum(counts)])
        places = [self._place(where) for where, _ in rows]
        is_shared = [where.stop <= self.shared for where, _ in rows]
        with_shared = [
            w @ self.pairs[p][inside, : self.shared] for (p, inside), (_, w) in zip(places, rows, strict=True)
        ]
        whole = np.concatenate(with_shared)
        out = whole @ _inverse(self.of_shared) @ whole.T
        for number, pair in enumerate(self.pairs):
            here = [i for i, (p, _) in enumerate(places) if p == number or is_shared[i]]
            index = np.concatenate([np.arange(first[i], first[i + 1]) for i in here])
            wide = np.zeros((len(index), len(pair)))
            start = 0
            for i in here:
                wide[start : start + counts[i], places[i][1]] = rows[i][1]
                start += counts[i]
            out[np.ix_(index, index)] = wide @ pair @ wide.T
        return out

    def conditioned(self, weights: Array, index: Sequence[IntArray], away: Sequence[Array]) -> Conditioning:
        """Numbers k, linear in the shared parameters by `weights` (S, n), if parameters b were known.

        b stand at `index` of the parts: of the shared ones, and of each recording's own. Over several recordings
        Woodbury's identity brings the inverse of the covariance of b to the size of the shared parameters.
        """
        n = self.shared
        if len(self.pairs) == 1:
            inside, whole = np.concatenate([index[0], index[1] + n]), np.concatenate(away)
            pair = self.pairs[0]
            across, inverse = weights @ pair[:n, inside], _inverse(pair[np.ix_(inside, inside)])
            regression = across @ inverse
            explained = np.einsum("si,si->s", regression, across)
            return Conditioning(explained, regression @ whole, float(whole @ inverse @ whole))
        told, right, square, precision = np.zeros((n, n)), np.zeros(n), 0.0, _inverse(self.of_shared)
        for pair, i, by in zip(self.pairs, index[1:], away[1:], strict=True):
            onto = pair[n + i, :n] @ precision
            inverse = _inverse(pair[np.ix_(n + i, n + i)] - onto @ pair[:n, n + i])
            told += onto.T @ inverse @ onto
            right += onto.T @ inverse @ by
            square += float(by @ inverse @ by)
        kept = self.of_shared @ np.linalg.inv(np.eye(n) + told @ self.of_shared)  # (C^-1 + M)^-1
        moved, square = kept @ right, square - float(right @ kept @ right)
        inverse, left = _inverse(kept[np.ix_(index[0], index[0])]), away[0] - moved[index[0]]
        moved = moved + kept[:, index[0]] @ inverse @ left
        kept = kept - kept[:, index[0]] @ inverse @ kept[index[0]]
        explained = np.einsum("sn,nm,sm->s", weights, self.of_shared - kept, weights)
        return Conditioning(explained, weights @ moved, square + float(left @ inverse @ left))

    def _place(self, where: slice) -> tuple[int, slice]:
        """In which pair, and where in it."""
        if where.stop <= self.shared:
            return 0, where
        for number, part in enumerate(self.parts[1:]):
            if part.start <= where.start and where.stop <= part.stop:
                shift = part.start - self.shared
                return number, slice(where.start - shift, where.stop - shift)
        raise ValueError(f"{where} is in more than one of {self.parts}")


def _inverse(covariance: Array) -> Array:
    """(n, n) pseudo-inverse, whatever the units."""
    if not len(covariance):
        return covariance
    sd = np.sqrt(np.diag(covariance))
    return np.asarray(
        np.linalg.pinv(covariance / np.outer(sd, sd), rcond=_MOST_TOLD, hermitian=True) / np.outer(sd, sd)
    )
