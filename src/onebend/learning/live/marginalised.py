"""Key frames that were marginalised: their information on the parameters x and on one slow force error e.

It is kept as a square root: rows of unit noise, not the information matrix. Each change of the force error subtracts
information; subtracted from a matrix, rounding errors would grow until it is no longer positive definite. Triangular
rows stay valid: the square-root information filter (Bierman, Factorization Methods for Discrete Sequential Estimation,
1977).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from onebend.learning.inference.information_form import InformationForm
from onebend.learning.live.force_process import ForceProcess, fast_variance, slow_variance
from onebend.learning.live.key_frames import AT_REST, KeyFrames
from onebend.records import Array


@dataclass
class Marginalised:
    """The marginalised frames, as they were linearised last."""

    rows: Array  # (n + 2, n + 3) upper triangular `[R | z]`: -2 log likelihood |R (x, e) - z|^2
    time: float  # s, of the slow force error e (2,); minus infinity while nothing is marginalised
    own: float = 0.0  # the load's own time there

    @property
    def form(self) -> InformationForm:
        """The same on all n + 2 of (x, e)."""
        root, z = self.rows[:, :-1], self.rows[:, -1]
        return InformationForm(root.T @ root, root.T @ z)

    def add(self, new_rows: Array, time: float, own: float, *, slow: float, fast: float) -> None:
        """Add one frame's rows (R, n + 3) on x and its own force error; the slow error moves to that frame's time.

        `slow`: N^2, variance of the slow error's change since the last; `fast`: N^2, of the rest of the frame's error.
        """
        before = with_error_change(self.rows, slow) if np.isfinite(self.time) else self.rows
        both = np.concatenate([before, with_error_change(new_rows, fast)])
        self.rows, self.time, self.own = _triangle(both)[: len(self.rows)], time, own


def nothing_marginalised(parameters: int) -> Marginalised:
    """The start: no frame is marginalised."""
    return Marginalised(np.zeros((parameters + 2, parameters + 3)), -np.inf)


def marginalise_oldest(
    keys: KeyFrames, marginalised: Marginalised, process: ForceProcess, marker: float, lately: Callable[[Array], Array]
) -> None:
    """Marginalise the oldest key frame, under this force error and noise `marker` of the tags.

    `lately`: what the load's last changes add to its own time at given times.
    """
    begin, end, frames = (float(values[0]) for values in (keys.begin, keys.end, keys.frames))
    here, there = lately(np.array([keys.centre[0], marginalised.time])).tolist()
    own = float(keys.own[0]) - marginalised.own + here - there
    slow, fast = slow_variance(process, end - marginalised.time, own), fast_variance(process, end - begin, frames)
    marginalised.add(likelihood_rows(keys, 0, marker, process.white), end, float(keys.own[0]), slow=slow, fast=fast)
    keys.drop(0)


def likelihood_rows(keys: KeyFrames, i: int, marker: float, white: float) -> Array:
    """(R, n + 3) rows `[J, -A | zeta]` of unit noise on x and the force error of frame i, at these sizes of noise;
    at rest two more, of the log itkeys.
    """
    root = np.repeat(np.sqrt(keys.weight[i]), 3)[:, None] / marker
    rows = root * keys.rows[i]
    rows[:, -3:-1] *= -1.0
    if not keys.rest[i]:
        return np.asarray(rows)
    certain = np.sqrt(keys.frames[i]) / (AT_REST * white)
    log = np.zeros((2, rows.shape[1]))
    log[:, -3:-1], log[:, -1] = certain * np.eye(2), certain * keys.force[i]
    return np.concatenate([rows, log])


def with_error_change(rows: Array, variance: float) -> Array:
    """Rows on (x, c) that hold the information of `rows` (R, n + 3) on (x, e), where e = c + d and d (2,) is integrated
    out: normal with this variance [N^2] on each axis. There are at most as many as before.
    """
    if variance <= 0.0:
        return rows
    wide = np.zeros((len(rows) + 2, rows.shape[1] + 2))  # d before the others: its rows come out on top
    wide[:2, :2] = np.eye(2) / np.sqrt(variance)
    wide[2:, :2], wide[2:, 2:] = rows[:, -3:-1], rows
    return _triangle(wide)[2:, 2:]


def _triangle(rows: Array) -> Array:
    """R of the QR decomposition: at most as many rows as columns, zero below the diagonal."""
    return np.asarray(np.linalg.qr(rows, mode="r"))
