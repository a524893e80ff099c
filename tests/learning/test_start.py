"""Where the fit begins: the nearest of the beams that are tried, and none for nothing."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.learning import start
from onebend.learning.start import start_of
from tests import made_up


def test_soft_beams_that_lead_away_are_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = made_up.observations()
    tried: list[float] = []
    plain = start._distance

    def counted(beam: Beam, *rest: object) -> float:
        tried.append(float(beam.stiffness(0.5)))
        return plain(beam, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(start, "_distance", counted)
    found = start_of([seen], None)
    some, few = tried.copy(), len(tried)
    monkeypatch.setattr(start, "_FAR", np.inf)
    assert found == start_of([seen], None)  # as if all had been tried
    assert len(tried) - few == len(start._TRIED) > few
    assert min(some) > min(tried)
