"""Numbers and sentences for people: those of `sentences.toml` by code, and those that depend on a whole run."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from string import Formatter
from typing import Any, Literal

import numpy as np

from onebend import records
from onebend.beam.stiffness import UncertainStiffness, half_width_words
from onebend.learning import attribution, design, frequencies, outcome, run


def name_of(findings: run.Run) -> str:
    """Names of the learned recordings."""
    return " + ".join(recording.source.name for recording in findings.recordings)


Kind = Literal["film", "tracks", "photos", "poses", "frequencies"]


@dataclass(frozen=True)
class KindWords:
    """Words for one kind of recording."""

    kind: Kind
    frames: str  # several of its instants
    under: str  # loads of the uncorrected simulation
    inputs: str  # heading of the inputs


WORDS: dict[Kind, KindWords] = {
    "film": KindWords("film", "frames", "under the force as logged", "Force and clock"),
    "tracks": KindWords("tracks", "frames", "under the force as logged", "Force and clock"),
    "photos": KindWords("photos", "photos", "under the loads as written", "Loads and photos"),
    "poses": KindWords("poses", "poses", "under the loads as written", "Loads and points"),
    "frequencies": KindWords("frequencies", "frequencies", "as it swings", "Frequencies"),
}


def kind_of(observations: records.Observations) -> Kind:
    if observations.frequencies and observations.static and not np.any(observations.marker_s):
        return "frequencies"
    if observations.static:
        return "poses" if observations.source.view is None else "photos"
    return "tracks" if observations.source.view is None else "film"


def words_of(observations: records.Observations) -> KindWords:
    return WORDS[kind_of(observations)]


def is_forced(observations: records.Observations) -> bool:
    """Whether a known force bends it, not its weight alone."""
    if not observations.static:
        return observations.source.clean_force is not None
    return observations.known_loads is not None or bool(np.any(observations.force != 0.0))


def only_static(recordings: Sequence[records.Observations]) -> bool:
    return all(one.static for one in recordings)


def learned_from(observations: records.Observations) -> str:
    """ "440 loaded frames of a film (600 in all)", "6 poses under known loads"."""
    swings = f"{len(observations.frequencies)} natural frequencies"
    if kind_of(observations) == "frequencies":
        return swings
    return _shown(observations) + (f", and {swings}" if observations.frequencies else "")


def only_frequencies(recordings: Sequence[records.Observations]) -> bool:
    return all(kind_of(one) == "frequencies" for one in recordings)


def _shown(observations: records.Observations) -> str:
    count, used, kind = len(observations.time), int(observations.loaded.sum()), kind_of(observations)
    if observations.static:
        of = "photos of the beam" if kind == "photos" else "static poses"
        return f"{count} {of} under {'known loads' if is_forced(observations) else 'its own weight'}"
    of = "a film" if kind == "film" else "marker tracks"
    if not is_forced(observations):
        return f"{count} frames of {of}, under its own weight"
    return f"{used} loaded frames of {of} ({count} in all)"


UNKNOWN = "–"
SMALL = 9.5e-5  # m: shown with two digits

_LINEAR = 1.0  # change of log k up to which first order holds
ANOTHER = "another"


def significant(value: float, digits: int = 3) -> str:
    """`value` with that many digits, without an exponent if possible; a dash if unknown."""
    if not np.isfinite(value):
        return UNKNOWN
    if value == 0.0 or not 1e-4 <= abs(value) < 1e6:
        return f"{float(value):.{digits}g}"
    value = float(f"{value:.{digits - 1}e}")  # rounded first: 18728 has no more digits than 0.0187
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{float(value):.{max(decimals, 0)}f}"


def span(low: float, high: float, between: str = " to ") -> str:
    """Two values, or one if equal."""
    first, last = significant(low), significant(high)
    return first if first == last else f"{first}{between}{last}"


def millimetres(metres: float) -> str:
    """mm with two decimals, or two digits if small; a dash if unknown."""
    if np.isfinite(metres) and 0.0 < abs(metres) < SMALL:
        return significant(1000.0 * float(metres), 2)
    return f"{1000.0 * float(metres):.2f}" if np.isfinite(metres) else UNKNOWN


def length_words(metres: float, digits: int = 2) -> str:
    """mm; "less than 0.001 mm" rather than 0."""
    return "less than 0.001 mm" if metres < 1e-6 else f"{significant(1e3 * metres, digits)} mm"


def bic_words(bic: float) -> str:
    """One decimal; a dash for an excluded pair (n, m)."""
    return f"{bic:.1f}" if np.isfinite(bic) else UNKNOWN


def counted(count: int, what: str) -> str:
    """ "1 warning", "2 warnings"."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def worst_tag(comparison: outcome.Comparison) -> str:
    """The largest RMS, with its tag."""
    if not np.isfinite(comparison.rms).any():
        return UNKNOWN
    i = int(np.nanargmax(comparison.rms))
    whole = f"{millimetres(comparison.rms[i])} mm ({tag_words(comparison, i)})"
    return whole.replace("tag ", "tag\N{NO-BREAK SPACE}").replace(" mm", "\N{NO-BREAK SPACE}mm")


def tag_words(comparison: outcome.Comparison, index: int) -> str:
    """As `marker_words`."""
    return records.marker_words(int(comparison.tag_id[index]), float(comparison.marker_s[index]))


def legend_words(comparison: outcome.Comparison, index: int, *, place: bool = False) -> str:
    """For legends: "tag 3", with its place "tag 3, s = 1"; of a point of an outline its place alone."""
    number, s = int(comparison.tag_id[index]), float(comparison.marker_s[index])
    at = f"s = {s:.3g}"
    if number >= records.POINT_ID:
        return at
    return f"tag {number}, {at}" if place else f"tag {number}"


def axis_words(numbers: Sequence[int]) -> list[str]:
    """For marks along an axis that shows s: "tag 1", "2", "3"; of an outline only its first point has a word."""
    first = "outline" if numbers[0] >= records.POINT_ID else f"tag {numbers[0]}"
    return [first, *("" if i >= records.POINT_ID else f"{i}" for i in numbers[1:])]


def clock_words(clock: records.ClockOffset) -> str:
    """The offset with its sd, against the stated one."""
    if clock.sd == 0.0:
        return f"{clock.offset:.3f} s as written in recording.toml, which calls it exact"
    if not clock.found:
        return f"{clock.offset:.3f} s as written in recording.toml; the data could not settle it"
    away = 1000.0 * (clock.offset - clock.stated)
    said = f", {away:+.0f} ms from the written {clock.stated:.3f} s" if np.isfinite(clock.stated) else ""
    return (
        f"{clock.offset:.3f} s ± {1000.0 * clock.sd:.1f} ms (sd){said}; a constant lag of the force sensor is part of "
        "it"
    )


def inputs(observations: records.Observations) -> list[tuple[str, str]]:
    """Processing of the force log and the clocks, row by row."""
    rows = [] if observations.source.clean_force is None else _force_rows(observations.source.clean_force)
    if observations.static:
        rows += _load_rows(observations)
    if observations.source.clock is not None:
        rows.append(("log time less video time", clock_words(observations.source.clock)))
    if observations.source.view is not None:
        how = (
            "calibrated"
            if observations.source.view.calibrated
            else "not calibrated: lens and focal length inferred from the tags"
        )
        rows.append(("camera", f"{how}; corners to {observations.source.view.corner_sd:.2f} px (sd)"))
    if kind_of(observations) == "frequencies":
        return [*rows, ("natural frequencies", str(len(observations.frequencies)))]
    found = 100.0 * np.isfinite(observations.xy[..., 0]).mean(axis=0)
    shown = records.read_before_fit(observations)
    places = zip(observations.tag_id[shown].tolist(), observations.marker_s[shown].tolist(), found[shown], strict=True)
    tags = ", ".join(f"{records.marker_words(number, s)} {share:.1f} %" for number, s, share in places)
    words = words_of(observations)
    return [*rows, (f"{words.frames} in which a tag was found", tags)]


def _force_rows(clean: records.CleanForce) -> list[tuple[str, str]]:
    known = bool(np.isfinite(clean.drift).any())
    drift = _pair(1000.0 * clean.drift, "mN/s") if known else "unknown (only one rest was seen)"
    filtered = f"zero-phase, {significant(clean.cutoff)} Hz" if np.isfinite(clean.cutoff) else "none"
    return [
        ("tare taken off (x, y)", _pair(clean.tare, "N")),
        ("drift between the rests (x, y)", drift),
        ("low-pass filter", filtered),
        ("noise left in the force (x, y), sd", _pair(1000.0 * clean.noise_sd, "mN")),
        ("outliers replaced", f"{clean.outliers} of {len(clean.time)} rows"),
    ]


def _load_rows(observations: records.Observations) -> list[tuple[str, str]]:
    if not is_forced(observations):
        return []
    size, sd = np.linalg.norm(observations.force, axis=1), 1e3 * float(np.max(observations.force_sd))
    known = f"each to {significant(sd, 2)} mN (sd)" if sd > 0.0 else "taken as exact"
    more = "; further forces or moments besides" if observations.known_loads is not None else ""
    return [("loads", f"{significant(float(size.min()))} … {significant(float(size.max()))} N, {known}{more}")]


def _pair(values: Iterable[float], unit: str) -> str:
    return ", ".join(significant(value) for value in values) + f" {unit}"


def assumptions(findings: run.Run) -> list[str]:
    """Assumptions behind the result."""
    recording = findings.recordings[0]
    rest = "straight when nothing pushes it" if recording.stated.rest == "straight" else "of unknown shape at rest"
    weight = "its weight acts in the plane of bending and is simulated" if np.any(recording.gravity != 0.0) else (
        "gravity acts across the plane of bending, so its weight does not bend it"
    )  # fmt: skip
    if only_frequencies(findings.recordings):
        weight = "its weight stiffens, softens and bends it as each posture says"
        return [f"The beam is planar, is clamped at s = 0, and is {rest}; {weight}.", *_loading(recording)]
    sd = millimetres(recording.stated.placement_sd)
    return [
        f"The beam is planar, is clamped at s = 0, and is {rest}; {weight}.",
        _allowed(findings),
        *_loading(recording),
        f"Each tag sits at its written s to {sd} mm (sd).",
    ]


def _loading(recording: records.Observations) -> list[str]:
    if kind_of(recording) == "frequencies":
        return ["It swings freely about rest, and so little that its frequencies do not depend on how far."]
    if recording.static:
        loads = "The loads act where they are written, and nothing else touches the beam."
        return [
            f"The beam stood still in every one of the {words_of(recording).frames}.",
            loads if is_forced(recording) else "Nothing but its weight bends it.",
        ]
    if not is_forced(recording):
        return ["Every frame is in equilibrium: the beam is turned slowly.", "Nothing but its weight bends it."]
    return [
        "Every frame is in equilibrium: the push is slow against the beam's own vibrations.",
        "The logged force acts at one point of the beam, and nothing else touches it.",
        "The force sensor's reading at rest is subtracted. Its scale error shows only under load; it is not seen, and "
        "goes into k.",
    ]


def _allowed(findings: run.Run) -> str:
    none = "It neither stretches nor shears, and the material does not relax."
    if findings.posterior is None:
        return none
    inside = {one.name for recording in findings.posterior.recordings for one in recording.allowances}
    names = [name for name, blocks in attribution.GROUPS.items() if inside & set(blocks)]
    return f"The fit also allows for {', '.join(names)}." if names else none


def grown_words(shift: float) -> str:
    """A change of log k as one of k in percent."""
    return f"{100.0 * np.expm1(shift):.2g} %"


def change_words(shift: float) -> str:
    """Change of k(s) in percent, or "another" beyond first order."""
    return grown_words(shift) if shift < _LINEAR else ANOTHER


LEVELS = ((0.95, 0.14), (0.80, 0.20), (0.50, 0.32))  # and opacity
_S = np.linspace(0.0, 1.0, 401)


def highest_shown(uncertain: UncertainStiffness) -> float:
    """N m, top of an axis of k(s): set by the identified part, plus up to 30 % for the rest."""
    band = uncertain.band(_S)
    known = float(np.max(band.high[uncertain.best_known(_S)]))
    return max(known, min(float(np.max(band.k)), 1.3 * known))


def direction_words(direction: float) -> str:
    """Direction [rad] in the beam's frame: up is to its left, out towards its tip."""
    degrees = float(np.rad2deg(np.angle(np.exp(1j * direction))))
    side, off = ("up", 90.0 - degrees) if degrees >= 0.0 else ("down", 90.0 + degrees)
    return side if abs(off) < 0.5 else f"{side} and {abs(off):.0f} deg {'out' if off > 0.0 else 'back'}"


def width_words(width: float) -> str:
    return half_width_words(0.5 * width)


@dataclass(frozen=True)
class Sentence:
    text: str
    about: str = ""  # a key of `sections.toml`; empty: no warning
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
        if isinstance(value, outcome.Notice):
            return words(value)
        unit = _UNIT.fullmatch(format_spec)
        if unit is None:
            return str(super().format_field(value, format_spec))
        scaled = _UNITS[unit[1]] * value
        return f"{scaled:{unit[2]}}" if unit[2] else two_digits(scaled)


def say(code: str, **values: Any) -> str:
    """The sentence of a code."""
    return _Template().format(SENTENCES[code].text, **values)


def words(notice: outcome.Notice) -> str:
    """The sentence of a notice, with its recording if there are several."""
    whose = f"{notice.whose}: " if notice.whose else ""
    if "causes" in notice.values and notice.code.startswith("more"):
        return whose + _more(notice)
    return whose + say(notice.code, **notice.values)


def worded(notices: Iterable[outcome.Notice | records.Remark]) -> tuple[records.Remark, ...]:
    """Notices as warnings (with a section in docs/troubleshooting.md) or notes."""
    return tuple(one if isinstance(one, records.Remark) else _worded(one) for one in notices)


def _worded(notice: outcome.Notice) -> records.Remark:
    causes = notice.values.get("causes", ())
    about = SENTENCES[causes[0].code if causes else notice.code].about
    level: Literal["warning", "note"] = "warning" if about else "note"
    return records.Remark(level, words(notice), about=about)


def remedy(cause: outcome.Notice) -> str:
    """What to do about a cause."""
    sentence, values = SENTENCES[cause.code], cause.values
    if values["static"] and sentence.do_for_poses:
        return sentence.do_for_poses
    do = sentence.do if values["filmed"] else sentence.do_without_camera or sentence.do
    return _Template().format(do, **values)


def _more(notice: outcome.Notice) -> str:
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


def pair_remarks(comparison: outcome.Comparison, observations: records.Observations) -> list[records.Remark]:
    """Remarks on one validation."""
    missed = outcome.poor_fit(comparison, other=True) or outcome.another_beam(comparison)
    return [*observations.source.remarks, *worded((*comparison.remarks, *missed))]


def all_remarks(findings: run.Run) -> list[tuple[str, records.Remark]]:
    """Every remark once, with its recording; warnings first."""
    found: dict[tuple[str, str], tuple[str, records.Remark]] = {}
    groups = [(name_of(findings), list(findings.remarks))]
    for comparison, recording in zip(findings.trainings, findings.recordings, strict=True):
        # For static poses this is a notice of the fit.
        missed = () if comparison.static and findings.posterior else outcome.poor_fit(comparison)
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


def modulus_unit(values: records.Array) -> tuple[float, str]:
    """Unit [Pa] and name for these moduli [Pa]."""
    known = values[np.isfinite(values)]
    middle = float(np.median(np.abs(known))) if known.size else 0.0
    return next((unit for unit in MODULUS_UNITS if middle >= unit[0]), MODULUS_UNITS[-1])


def size_words(section: records.StatedSection) -> list[str]:
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


def _lengths(size: records.Array) -> str:
    return _range(size, "m") if np.max(size) >= 1.0 else _range(1e3 * size, "mm")


def _range(values: records.Array, unit: str) -> str:
    least, most = f"{float(np.min(values)):.3g}", f"{float(np.max(values)):.3g}"
    return f"{least} {unit}" if least == most else f"{least} to {most} {unit}"


def posture_words(posture: frequencies.Posture) -> str:
    """Orientation of the base, and mass at the tip."""
    x, y = posture.gravity.tolist()
    size = float(np.hypot(x, y))
    held = "across gravity"
    if size > 0.0:
        upwards = {1.0: "hangs", -1.0: "stands", 0.0: "lies"}.get(round(x / size, 6))
        held = upwards or f"base {np.degrees(np.arcsin(-x / size)):.3g} deg above level"
    tip = sum(point.mass for point in posture.points if point.s == 1.0)
    return f"{held}, {1e3 * tip:.3g} g at the tip" if tip > 0.0 else held


def _swing(row: frequencies.ComparedFrequency, kind: Literal["validated", "fitted", "odd"]) -> str:
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


def _identified(quality: design.Quality) -> str:
    if quality.identified in (0.0, 1.0):
        return "identified all along" if quality.identified else "identified nowhere"
    if quality.identified_to > quality.identified - 0.02:
        return f"identified to s = {quality.identified_to:.2f}"
    return f"identified on {100.0 * quality.identified:.0f} % of the beam"


def _moduli(values: records.Array) -> str:
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
