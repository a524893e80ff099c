"""The paper's printed numbers, as data. Each names its table; lengths in metres as printed.

The text of the paper at hand has the rows of Tables II, IV and V. Of Tables I, III and VI it has the captions and the
text about them, but no rows: these are None here.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

M3 = tuple[float, float, float]  # m, of the markers M1 to M3


@dataclass(frozen=True)
class PrintedTrial:
    """A row of Tables I to III."""

    n: int
    m: int
    rms: M3
    bic: float


@dataclass(frozen=True)
class PrintedBeam:
    """What the paper says of one beam."""

    selection_table: str
    trials: tuple[PrintedTrial, ...] | None
    chosen: tuple[int, int]  # (n, m), Section V-A
    validation_table: str
    validation: tuple[tuple[str, M3], ...] | None  # by strategy


def _trials(*rows: tuple[int, int, float, float, float, float]) -> tuple[PrintedTrial, ...]:
    return tuple(PrintedTrial(n, m, (a, b, c), bic) for n, m, a, b, c, bic in rows)


PRINTED = MappingProxyType(
    {
        "linear": PrintedBeam(
            selection_table="I",
            trials=None,
            chosen=(4, 4),
            validation_table="IV",
            validation=(
                ("fast", (0.0008, 0.0016, 0.0038)),
                ("s08", (0.0002, 0.0015, 0.0035)),
                ("s06", (0.0014, 0.0040, 0.0069)),
            ),
        ),
        "quadratic": PrintedBeam(
            selection_table="II",
            trials=_trials(
                (2, 2, 0.0012, 0.0010, 0.0022, 4.10),
                (3, 2, 0.0013, 0.0011, 0.0021, 4.10),
                (3, 3, 0.0012, 0.0011, 0.0021, 4.09),
                (4, 2, 0.0016, 0.0014, 0.0020, 4.16),
                (4, 3, 0.0013, 0.0013, 0.0021, 4.13),
                (4, 4, 0.0010, 0.0014, 0.0021, 4.08),
                (5, 2, 0.0010, 0.0012, 0.0023, 4.12),
                (5, 3, 0.0025, 0.0023, 0.0036, 4.69),
                (5, 4, 0.0011, 0.0023, 0.0030, 4.45),
                (5, 5, 0.0059, 0.0129, 0.0228, 6.39),
            ),
            chosen=(4, 4),
            validation_table="V",
            validation=(
                ("fast", (0.0005, 0.0017, 0.0039)),
                ("s08", (0.0005, 0.0021, 0.0049)),
                ("s06", (0.0008, 0.0022, 0.0033)),
            ),
        ),
        "cubic": PrintedBeam(selection_table="III", trials=None, chosen=(3, 2), validation_table="VI", validation=None),
    }
)
MOST_MODES = 5  # z, Section V-A


def printed_m3(beam: str, strategy: str) -> float | None:
    """m, the printed validation error of the marker at the tip; None where the text has none."""
    rows = dict(PRINTED[beam].validation or ())
    return rows[strategy][2] if strategy in rows else None
