"""Stage tables of collocation."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.integration import Tableau
from onebend.errors import MechanicsError


def test_a_stage_table_that_is_no_collocation_is_refused() -> None:
    half = np.array([0.5])
    with pytest.raises(MechanicsError, match="not a collocation method"):
        Tableau(half, np.array([[0.4]]), np.ones(1), np.ones(1), np.eye(1))
