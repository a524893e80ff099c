"""What a batch found: a record for every recording that was asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from onebend.batch.listing import Item
from onebend.batch.outliers import Scores, scores
from onebend.batch.record import EVERY, PLACES, Record


@dataclass(frozen=True)
class BatchOutcome:
    """All recordings of a batch in the order of the list."""

    out: Path
    items: tuple[Item, ...]
    records: tuple[Record, ...]
    scores: Scores
    learned_now: int  # recordings that this run learned from, or tried to; the others were there

    @property
    def failed(self) -> tuple[tuple[Item, str], ...]:
        """Recordings without k(s), each with its reason."""
        return tuple((item, one.reason) for item, one in zip(self.items, self.records, strict=True) if one.reason)

    @property
    def outliers(self) -> tuple[tuple[Item, str], ...]:
        """Recordings unlike the others of their group, each with its reason."""
        return tuple((item, why) for item, why in zip(self.items, self.scores.reasons, strict=True) if why)


def outcome_of(out: Path, items: Sequence[Item], records: Sequence[Record], learned_now: int) -> BatchOutcome:
    """The records, and how each is beside the others."""
    count = len(PLACES[::EVERY])
    log_k, covariance = np.full((len(records), count), np.nan), np.full((len(records), count, count), np.nan)
    for i, one in enumerate(records):
        if one.k is not None and one.covariance is not None:
            log_k[i], covariance[i] = np.log(one.k[::EVERY]), one.covariance
    found = scores(log_k, covariance, [item.group for item in items])
    return BatchOutcome(out, tuple(items), tuple(records), found, learned_now)
