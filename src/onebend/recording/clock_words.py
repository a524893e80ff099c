"""What is said of two clocks that were matched, or could not be."""

from __future__ import annotations

from onebend.records import ClockOffset, Remark

TOO_LITTLE = "Film and log share too little force and motion to match the clocks"


def as_written(uncertainty: float) -> str:
    """What is used where the data settle nothing."""
    if uncertainty > 0.0:
        return "start_s is used as it is written"
    return (
        "start_s is used as it is written. start_uncertainty_s = 0 calls it exact: where it may be off, write by how "
        "much, or leave both out and the whole log is searched"
    )


def remarks_on(clock: ClockOffset, uncertainty: float, low: float, high: float) -> tuple[Remark, ...]:
    """What is odd about a found offset."""
    out = []
    if min(clock.offset - low, high - clock.offset) < 2 * clock.sd:
        text = "The clock offset found lies at the edge of the range searched; give a better start_s in [video]."
        out.append(Remark("warning", text))
    elif abs(clock.offset - clock.said) > uncertainty + 2 * clock.sd:
        text = f"The film starts {clock.offset - clock.said:+.2f} s from start_s, more than its uncertainty."
        out.append(Remark("warning", text))
    if clock.sd > 0.1:
        out.append(
            Remark("note", f"The clocks are matched to {clock.sd:.2f} s (one sd) only: the push is slow or weak.")
        )
    return tuple(out)
