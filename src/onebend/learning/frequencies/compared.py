"""Measured frequencies beside those of the fitted beam, row by row and in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.motion.frequencies import natural_frequencies
from onebend.learning.frequencies.frequency_data import Posture, postures_of
from onebend.learning.frequencies.predicted import PredictedFrequencies
from onebend.records import Observations, Remark

FAR, GROSS = 3.0, 6.0  # sd: a frequency that far from the fit is said to be odd; that far, k(s) is not to be trusted


@dataclass(frozen=True)
class ComparedFrequency:
    """One frequency as measured and as fitted."""

    recording: str
    mode: int  # 1 is the slowest
    posture: str
    measured: float  # Hz, undamped
    sd: float  # Hz
    fitted: float  # Hz

    @property
    def off(self) -> float:
        """Measured less fitted, in sd."""
        return (self.measured - self.fitted) / self.sd

    @property
    def words(self) -> str:
        """The whole row."""
        return (
            f"mode {self.mode} ({self.posture}) {self.measured:.5g} Hz (sd {self.sd:.2g}), the fit {self.fitted:.5g} Hz"
        )


def compared_frequencies(predicted: Sequence[PredictedFrequencies]) -> tuple[ComparedFrequency, ...]:
    """All of them, recording by recording and posture by posture."""
    out = []
    for one in predicted:
        measured, fitted = np.exp(one.data.measured), np.exp(one.log)
        for posture in one.data.postures:
            for row, mode in zip(posture.rows.tolist(), posture.modes.tolist(), strict=True):
                hz, sd = float(measured[row]), float(measured[row] * one.data.sd[row])
                name, words = one.data.name, posture_words(posture)
                out.append(ComparedFrequency(name, mode + 1, words, hz, sd, float(fitted[row])))
    return tuple(out)


def validated_frequencies(beam: Beam, o: Observations) -> tuple[Remark, ...]:
    """A note on how a beam with a mass, learned elsewhere, swings beside what was measured; nothing where a mode is
    not said."""
    known = [one for one in o.frequencies if one.mode > 0]
    if not known:
        return ()
    rows = []
    for posture in postures_of(tuple(known), () if beam.masses else o.stated.masses):
        count = int(np.max(posture.modes)) + 1
        own = natural_frequencies(beam, gravity=posture.gravity, points=posture.points, count=count)
        for row, mode in zip(posture.rows.tolist(), posture.modes.tolist(), strict=True):
            off = 100.0 * (float(own[mode]) / known[row].frequency - 1.0)
            said = f"mode {mode + 1} ({posture_words(posture)}) {known[row].frequency:.5g} Hz"
            rows.append(f"{said}, the beam {float(own[mode]):.5g} Hz ({off:+.2g} %)")
    return (Remark("note", f"frequencies: {'; '.join(rows)}"),)


def frequency_remarks(predicted: Sequence[PredictedFrequencies]) -> tuple[Remark, ...]:
    """A note with all of them, a warning on those that the fit does not follow."""
    rows = compared_frequencies(predicted)
    if not rows:
        return ()
    remarks = [Remark("note", f"frequencies: {'; '.join(row.words for row in rows)}")]
    odd = [row for row in rows if not abs(row.off) < FAR]
    if odd:
        each = "; ".join(f"{row.words}, {abs(row.off):.2g} sd off" for row in odd)
        text = (
            f"the fit does not follow every frequency: {each}. Check `mode`, base_angle_deg and tip_mass_kg of each, "
            "mass_along and stiffness_along, that the clamp is firm, and that sd_hz is not too small"
        )
        remarks.append(Remark("warning", text, about="frequencies"))
    return tuple(remarks)


def worst_off(predicted: Sequence[PredictedFrequencies]) -> float:
    """sd, of the frequency farthest from the fit; NaN where none was measured."""
    return max((abs(row.off) for row in compared_frequencies(predicted)), default=math.nan)


def posture_words(posture: Posture) -> str:
    """How the base was held, and what was at the tip."""
    x, y = posture.gravity.tolist()
    size = math.hypot(x, y)
    words = "across gravity"
    if size > 0.0:
        upwards = {1.0: "hangs", -1.0: "stands", 0.0: "lies"}.get(round(x / size, 6))
        words = upwards or f"base {math.degrees(math.asin(-x / size)):.3g} deg above level"
    tip = sum(point.mass for point in posture.points if point.s == 1.0)
    return f"{words}, {1e3 * tip:.3g} g at the tip" if tip > 0.0 else words
