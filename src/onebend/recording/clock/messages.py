"""Remarks on the clock offset: found, or not found."""

from __future__ import annotations

from onebend.recording.clock.offset_prior import ROUGHLY
from onebend.records import ClockOffset, Remark

AS_WRITTEN = "start_s is used as it is written"
_CONTRADICTS = 3.0  # sd of the data beyond the uncertainty
TOO_LITTLE = (
    f"Film and log share too little force and motion to match the clocks; {AS_WRITTEN}. Push further, or measure "
    "start_s."
)


def unsettled_remark(shift: float, sd: float, uncertainty: float) -> Remark:
    """The remark where the data leave the offset as uncertain (`sd` [s]) as it was. `shift` [s]: the data's best
    offset less the stated one."""
    if uncertainty < ROUGHLY and abs(shift) > uncertainty + _CONTRADICTS * sd:
        text = f"The data would have the film start {shift:+.3f} s from start_s, more than its uncertainty"
        text += f"; {AS_WRITTEN}. If it may be wrong, give a larger start_uncertainty_s."
        return Remark("warning", text, about="clock")
    if uncertainty < ROUGHLY:
        return Remark("note", f"The data tell the clocks' offset no better than start_uncertainty_s; {AS_WRITTEN}.")
    text = f"The clocks could not be matched from the data (one sd {sd:.2g} s); {AS_WRITTEN}. Check it."
    return Remark("warning", text, about="clock")


def remarks_on(clock: ClockOffset, uncertainty: float, low: float, high: float) -> tuple[Remark, ...]:
    """Warnings and notes on an offset that was found."""
    remarks = []
    if min(clock.offset - low, high - clock.offset) < 2 * clock.sd:
        text = "The clock offset found lies at the edge of the range searched; give a better start_s in [video]."
        remarks.append(Remark("warning", text, about="clock"))
    elif abs(clock.offset - clock.stated) > uncertainty + 2 * clock.sd:
        text = (
            f"The film starts {clock.offset - clock.stated:+.2f} s from start_s, more than its uncertainty. Correct "
            "start_s."
        )
        remarks.append(Remark("warning", text, about="clock"))
    if clock.sd > 0.1:
        remarks.append(
            Remark("note", f"The clocks are matched to {clock.sd:.2f} s (one sd) only: the push is slow or weak.")
        )
    return tuple(remarks)
