"""The sentences of `sentences.toml`, by code, with their numbers."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.resources import files
from string import Formatter
from typing import Any, Literal

import numpy as np

from onebend.learning.design import Quality
from onebend.learning.frequencies import ComparedFrequency, Posture
from onebend.learning.outcome import Comparison, Notice, another_beam, poor_fit
from onebend.learning.run import Run
from onebend.records import Array, Observations, Remark, StatedSection
from onebend.report.wording import direction_words, name_of, width_words


@dataclass(frozen=True)
class Sentence:
    text: str
    about: str = ""  # a key of `errors.SECTIONS`; empty: no warning
    do: str = ""  # remedy of a cause
    do_for_poses: str = ""  # for static poses, if different
    do_without_camera: str = ""  # without a film, if different


_FILE = files("onebend.report").joinpath("sentences.toml").read_text(encoding="utf-8")
SENTENCES = {code: Sentence(**entry) for code, entry in tomllib.loads(_FILE).items()}
_UNITS = {"mm": 1e3, "mN": 1e3, "g": 1e3, "ms": 1e3, "deg": 180.0 / np.pi, "percent": 1e2}
_UNIT = re.compile(rf"({'|'.join(_UNITS)})((?=$|[.+]).*)")
MODULUS_UNITS = ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa"))
_MOST_POSES = 6  # named poses
# Power of a section's sizes in k(s).
_POWERS = {
    "rectangle": "width_m counts with its third power",
    "second moment": "it is in m^4: 1 mm^4 is 1e-12",
}


class _Template(Formatter):
    """`str.format` with units and words."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if format_spec in _WORDS_OF:
            return _WORDS_OF[format_spec](value)
        if isinstance(value, Notice):
            return words(value)
        unit = _UNIT.fullmatch(format_spec)
        if unit is None:
            return str(super().format_field(value, format_spec))
        scaled = _UNITS[unit[1]] * value
        return f"{scaled:{unit[2]}}" if unit[2] else two_digits(scaled)


def say(code: str, **values: Any) -> str:
    """The sentence of a code."""
    return _Template().format(SENTENCES[code].text, **values)


def words(notice: Notice) -> str:
    """The sentence of a notice, with its recording if there are several."""
    whose = f"{notice.whose}: " if notice.whose else ""
    if "causes" in notice.values and notice.code.startswith("more"):
        return whose + _more(notice)
    return whose + say(notice.code, **notice.values)


def worded(notices: Iterable[Notice | Remark]) -> tuple[Remark, ...]:
    """Notices as warnings (with a section in docs/troubleshooting.md) or notes."""
    return tuple(one if isinstance(one, Remark) else _worded(one) for one in notices)


def _worded(notice: Notice) -> Remark:
    causes = notice.values.get("causes", ())
    about = SENTENCES[causes[0].code if causes else notice.code].about
    level: Literal["warning", "note"] = "warning" if about else "note"
    return Remark(level, words(notice), about=about)


def remedy(cause: Notice) -> str:
    """What to do about a cause."""
    sentence, values = SENTENCES[cause.code], cause.values
    if values["static"] and sentence.do_for_poses:
        return sentence.do_for_poses
    do = sentence.do if values["filmed"] else sentence.do_without_camera or sentence.do
    return _Template().format(do, **values)


def _more(notice: Notice) -> str:
    values = notice.values
    parts = [say(notice.code)]
    if values["symptoms"]:
        parts.append(say("more: misfit", misfits="; ".join(map(words, values["symptoms"]))))
    if not values["causes"]:
        return ". ".join([*parts, say("more: no cause")])
    first, *others = values["causes"]
    parts.append(say("more: likeliest", cause=first, do=remedy(first)))
    if others:
        parts.append(say("more: others", causes="; ".join(map(words, others))))
    change = {name: values[name] for name in ("change", "widening")}
    return ". ".join([*parts, say("more: change" if np.isfinite(values["change"]) else "more: another", **change)])


def pair_remarks(comparison: Comparison, observations: Observations) -> list[Remark]:
    """Remarks on one validation."""
    missed = poor_fit(comparison, other=True) or another_beam(comparison)
    return [*observations.source.remarks, *worded((*comparison.remarks, *missed))]


def all_remarks(findings: Run) -> list[tuple[str, Remark]]:
    """Every remark once, with its recording; warnings first."""
    found: dict[tuple[str, str], tuple[str, Remark]] = {}
    groups = [(name_of(findings), list(findings.remarks))]
    for comparison, recording in zip(findings.trainings, findings.recordings, strict=True):
        # For static poses this is a notice of the fit.
        missed = () if comparison.static and findings.posterior else poor_fit(comparison)
        groups.append((comparison.name, [*recording.source.remarks, *worded((*comparison.remarks, *missed))]))
    for comparison, recording in zip(findings.validations, findings.validation_observations, strict=True):
        groups.append((comparison.name, pair_remarks(comparison, recording)))
    for whose, remarks in groups:
        for remark in remarks:
            found.setdefault((whose, remark.text), (whose, remark))
    return sorted(found.values(), key=lambda pair: pair[1].level != "warning")


def two_digits(value: float) -> str:
    """Without an exponent: 550."""
    return f"{float(f'{value:.2g}'):.9g}"


def odds(log10_p: float) -> str:
    """ "1 in N" with two digits, down to one in a billion."""
    count = 10.0 ** min(-log10_p, 9.0)
    whole = f"{count:.2g}" if count < 100.0 else f"{float(f'{count:.2g}'):,.0f}".replace(",", " ")
    return f"1 in {whole}" + (" or less" if log10_p < -9.0 else "")


def modulus_unit(values: Array) -> tuple[float, str]:
    """Unit [Pa] and name for these moduli [Pa]."""
    known = values[np.isfinite(values)]
    middle = float(np.median(np.abs(known))) if known.size else 0.0
    return next((unit for unit in MODULUS_UNITS if middle >= unit[0]), MODULUS_UNITS[-1])


def size_words(section: StatedSection) -> list[str]:
    """ "width_m 12 mm in the plane of bending", "diameter_m 4 to 9 mm"."""
    if section.moment is not None:
        return [f"I_m4 {_range(1e12 * section.moment, 'mm^4')}"]
    if section.shape == "hexagon":
        return [f"across_flats_m {_lengths(section.thickness)}"]
    if section.shape in ("circle", "tube"):
        outer = f"diameter_m {_lengths(section.thickness)}"
        return [outer] if section.inner is None else [outer, f"inner_diameter_m {_lengths(section.inner)}"]
    inside, across = _lengths(section.thickness), _lengths(section.width)
    return [f"width_m {inside} in the plane of bending", f"thickness_m {across} across it"]


def _lengths(size: Array) -> str:
    return _range(size, "m") if np.max(size) >= 1.0 else _range(1e3 * size, "mm")


def _range(values: Array, unit: str) -> str:
    least, most = f"{float(np.min(values)):.3g}", f"{float(np.max(values)):.3g}"
    return f"{least} {unit}" if least == most else f"{least} to {most} {unit}"


def posture_words(posture: Posture) -> str:
    """Orientation of the base, and mass at the tip."""
    x, y = posture.gravity.tolist()
    size = float(np.hypot(x, y))
    held = "across gravity"
    if size > 0.0:
        upwards = {1.0: "hangs", -1.0: "stands", 0.0: "lies"}.get(round(x / size, 6))
        held = upwards or f"base {np.degrees(np.arcsin(-x / size)):.3g} deg above level"
    tip = sum(point.mass for point in posture.points if point.s == 1.0)
    return f"{held}, {1e3 * tip:.3g} g at the tip" if tip > 0.0 else held


def _swing(row: ComparedFrequency, kind: Literal["validated", "fitted", "odd"]) -> str:
    measured = f"mode {row.mode} ({posture_words(row.posture)}) {row.measured:.5g} Hz"
    if kind == "validated":
        return f"{measured}, the beam {row.fitted:.5g} Hz ({100.0 * (row.fitted / row.measured - 1.0):+.2g} %)"
    off = f", {abs(row.off):.2g} sd off" if kind == "odd" else ""
    return f"{measured} (sd {row.sd:.2g}), the fit {row.fitted:.5g} Hz{off}"


def _places(where: tuple[float, float]) -> str:
    low, high = (f"{place:.2g}" for place in where)
    return f"at about s = {low}" if low == high else f"between s = {low} and {high}"


def _poses(off: tuple[tuple[str, float], ...]) -> str:
    named = ", ".join(f"pose {name} by {1e3 * far:.3g} mm" for name, far in off[:_MOST_POSES])
    return named + (f" and {len(off) - _MOST_POSES} more" if len(off) > _MOST_POSES else "")


def _identified(quality: Quality) -> str:
    if quality.identified in (0.0, 1.0):
        return "identified all along" if quality.identified else "identified nowhere"
    if quality.identified_to > quality.identified - 0.02:
        return f"identified to s = {quality.identified_to:.2f}"
    return f"identified on {100.0 * quality.identified:.0f} % of the beam"


def _moduli(values: Array) -> str:
    factor, unit = modulus_unit(values)
    return _range(values / factor, unit)


_WORDS_OF: dict[str, Callable[[Any], str]] = {  # by the format of a template's field
    "two": two_digits,
    "odds": odds,
    "places": _places,
    "poses": _poses,
    "modulus": _moduli,
    "direction": direction_words,
    "width": width_words,
    "identified": _identified,
    "again": lambda repeats: "once more: " if repeats else "",
    "with": lambda needs: f", with {words(needs)}" if needs else "",
    "sizes": lambda section: ", ".join(size_words(section)),
    "power": lambda section: _POWERS.get(section.shape, "the size counts with its fourth power"),
    "exact": lambda key: f" (exact, as no {key} is stated)" if key else "",
    "varies": lambda sd: f", and as free to vary slowly by {100.0 * sd:.2g} % (sd) beside that" if sd > 0.0 else "",
    "are": lambda ids: (
        f"tag {ids[0]} is" if len(ids) == 1 else f"tags {', '.join(map(str, ids[:-1]))} and {ids[-1]} are"
    ),
    "ratios": lambda rows: ", ".join(f"{r:.3g} at s = {s:g} ({low:.3g} to {high:.3g})" for s, r, low, high in rows),
    "validated": lambda rows: "; ".join(_swing(row, "validated") for row in rows),
    "fitted": lambda rows: "; ".join(_swing(row, "fitted") for row in rows),
    "odd": lambda rows: "; ".join(_swing(row, "odd") for row in rows),
}
