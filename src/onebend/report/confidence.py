"""The fit's uncertainty in words and rows: identified places, nuisances, allowances, tests, trade-offs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.section import ModulusBand, one_modulus
from onebend.beam.stiffness import IDENTIFIED_SD, Band, UncertainStiffness, half_width, half_width_words
from onebend.learning import criticism, outcome, run, verdict
from onebend.learning.attribution import FORCE_SCALE, SHIFTS, WIDENS, Attribution, hidden_by
from onebend.learning.posterior import Posterior, tradeoffs, with_level
from onebend.recording.signals import runs
from onebend.records import GAIN_SD, PLACE_SD, Array, Observations, StatedSection
from onebend.report import sentences
from onebend.report.sentences import modulus_unit, say, significant, span, words

FACTOR = float(np.exp(half_width(IDENTIFIED_SD)))  # k is identified where it is known to this factor
SMALL_SHARE = 0.05  # of the largest force: smaller errors under load are not mentioned
NARROW = 0.03  # in s: shorter gaps are joined
_MOST_TESTS = 8  # shown
_SLIVER = 0.01  # in s: shorter ranges are not named beside longer ones
UNITS = {  # of nuisances, and those in which they are shown
    "m": (1e3, "mm"),
    "rad": (180.0 / np.pi, "deg"),
    "m/rad": (1e3, "mm/rad"),
    "s": (1e3, "ms"),
    "1": (1e2, "%"),
    "N": (1e3, "mN"),
    "N/s": (1e3, "mN/s"),
}


def identified_ranges(uncertain: UncertainStiffness) -> list[tuple[float, float]]:
    """First and last s of every identified range, to 1/400."""
    s = np.linspace(0.0, 1.0, 401)
    known = uncertain.band(s).identified
    return [(float(s[first]), float(s[end - 1])) for first, end in runs(known)]


def identified_words(ranges: Sequence[tuple[float, float]]) -> str:
    """ "0.00 to 0.62 (but for 4 % of it), 0.71 to 0.90", without short gaps and stretches."""
    joined: list[list[tuple[float, float]]] = []
    for one in ranges:
        if joined and one[0] - joined[-1][-1][1] < NARROW:
            joined[-1].append(one)
        else:
            joined.append([one])
    longest = max(parts[-1][1] - parts[0][0] for parts in joined)
    words = []
    for parts in joined:
        begin, end = parts[0][0], parts[-1][1]
        if end - begin < min(_SLIVER, longest):
            continue
        missing = end - begin - sum(high - low for low, high in parts)
        but = f" (but for {max(100.0 * missing / (end - begin), 1.0):.0f} % of it)" if len(parts) > 1 else ""
        words.append(f"{begin:.2f} to {end:.2f}{but}")
    return ", ".join(words)


def typical_half_width(uncertain: UncertainStiffness) -> float:
    """Median half-width of the 95 % band of log k over identified places, or NaN."""
    ranges = identified_ranges(uncertain)
    if not ranges:
        return float("nan")
    s = np.concatenate([np.linspace(low, high, 51) for low, high in ranges])
    return float(np.median(uncertain.half_width(s)))


def half_widths(band: Band) -> list[str]:
    """ "7.4 %", "x 2.4"."""
    halves = 0.5 * np.log(band.high / band.low)
    return [half_width_words(float(half)).removeprefix("± ").replace("a factor of ", "x ") for half in halves]


def stiffness_range(findings: run.Run) -> tuple[float, float]:
    """Smallest and largest k(s) [N m] where identified, else of the whole beam."""
    s = np.linspace(0.0, 1.0, 201)
    k = findings.beam.stiffness(s)
    if findings.posterior is not None:
        known = findings.posterior.band(s).identified
        k = k[known] if known.any() else k
    return float(k.min()), float(k.max())


def unidentified_words(uncertain: UncertainStiffness, recordings: int = 1) -> list[str]:
    if uncertain.doubts:
        return [say("in doubt", doubts="; ".join(uncertain.doubts))]
    ranges = identified_ranges(uncertain)
    common = {"whose": "this recording says" if recordings == 1 else "these recordings say", "factor": FACTOR}
    if not ranges:
        return [say("nowhere", **common)]
    told = []
    if ranges[0][0] > 0.0:
        told.append(say("blind near the clamp", s=np.ceil(100 * ranges[0][0]) / 100, **common))
    gaps = [(before[1], after[0]) for before, after in pairwise(ranges)]
    told += [say("blind between", low=low, high=high, **common) for low, high in gaps if high - low >= NARROW]
    narrow = [f"{0.5 * (low + high):.2f}" for low, high in gaps if high - low < NARROW]
    if narrow:
        told.append(say("blind in places", places=", ".join(narrow), narrow=NARROW, **common))
    if ranges[-1][1] < 1.0:
        told.append(say("blind at the tip", s=ranges[-1][1], **common))
    return told


_LOOP_SHARE = 0.5  # of the scale's sd, from which the log's hysteresis is named as its source


def scale_words(gain_sd: float, recordings: Sequence[Observations], loop: float = 0.0) -> str:
    """The source of the scale of k(s): force, loads or weight. `loop`: half of what the log's scale differs by between
    a growing and a falling push."""
    if sentences.only_frequencies(recordings):
        return say("scale by mass")
    forced = [one for one in recordings if sentences.is_forced(one)]
    if not forced:
        return say("scale by weight")
    if not sentences.only_static(forced):
        if loop > _LOOP_SHARE * gain_sd:
            return say("gain of a loop", sd=gain_sd, loop=2.0 * loop)
        return say("gain", sd=gain_sd) if gain_sd > 0.0 else say("gain exact")
    sd = max(float(np.max(one.force_sd)) for one in forced)
    return say("loads", sd=significant(1e3 * sd)) if sd > 0.0 else say("loads exact")


def load_error_words(load_error: tuple[float, float]) -> list[str]:
    """A force error that comes with the load (sd [N], share of the largest force); empty if small."""
    size, share = load_error
    return [] if share < SMALL_SHARE else [say("load error", size=size, share=share)]


def stop_words(posterior: Posterior) -> str:
    found = posterior.optimum
    return say("converged" if found.converged else "stopped early", steps=found.steps, why=found.stopped)


def model_tests(posterior: Posterior) -> list[tuple[str, criticism.Finding]]:
    """What is tested, the smallest p-values first; none for a hopeless fit."""
    if any(misfit.hopeless for misfit in posterior.misses):
        return []
    able = verdict.possible(posterior).criticism.able[:_MOST_TESTS]
    return [(words(verdict.what_is_tested(finding, posterior)), finding) for finding in able]


def alarm_words(posterior: Posterior) -> str:
    """The threshold of the tests."""
    critic = verdict.possible(posterior).criticism
    code = "alarm of poses" if sentences.only_static([one.observations for one in posterior.recordings]) else "alarm"
    return say(code, tests=len(critic.able), odds=critic.alarm, written=max(critic.alarm, criticism.ALARM_WRITTEN))


def tradeoff_words(posterior: Posterior) -> list[str]:
    level = with_level(posterior)
    pairs = [*level, *(pair for pair in tradeoffs(posterior) if pair not in level)]
    return [say("together" if pair.correlation > 0.0 else "opposed", **vars(pair)) for pair in pairs]


def share_words(share: Attribution) -> str:
    """An allowance with its effect: `relaxation (ignoring it would shift k(s) by 9.8 %)`."""
    effects = []
    if share.sure and share.shift > SHIFTS:
        change = sentences.change_words(share.shift)
        effects.append(say("share: another" if change == sentences.ANOTHER else "share: left out", change=change))
    if share.widening > WIDENS:
        effects.append(say("share: wider", times=share.widening))
    effects = effects or [say("share: open", change=sentences.change_words(share.size))]
    return f"{share.name} ({', '.join(effects)})"


def narrower_words(posterior: Posterior) -> str:
    """At most two measures."""
    shares = sorted((one for one in posterior.attributions if one.matters), key=lambda one: -one.widening)
    seen = [recording.observations for recording in posterior.recordings]
    every = [(one.widening, what_to_do(one.name, seen)) for one in shares if one.widening > WIDENS]
    told = [f"{what} (up to {widening:.2f} times)" for widening, what in every if what]
    return ", ".join(told[:2])


def why_words(posterior: Posterior) -> str:
    s, count = np.linspace(0.0, 1.0, 101), sum(len(one.force) for one in posterior.recordings)
    alone, with_one = hidden_by(posterior.problem, posterior.optimum, posterior.gain_sd, s)
    static = all(one.observations.static for one in posterior.recordings)
    seen = "one pose does" if static and count == 1 else "the poses do" if static else "the push does"
    if np.min(alone) >= IDENTIFIED_SD:
        more = "bend the beam further, and read the points more exactly" if static else "push further"
        return say("hidden", seen=seen, do=more)
    best = int(np.argmin(alone))
    enough = {name: float(np.min(sd)) for name, sd in with_one.items() if np.min(sd) >= IDENTIFIED_SD}
    each = enough or {name: float(sd[best]) for name, sd in with_one.items() if sd[best] > WIDENS * alone[best]}
    names = sorted(each, key=lambda name: -each[name])[:3]
    how = "" if len(names) == 1 else ", each enough to hide it" if enough else ", which hide it together"
    width = half_width_words(float(half_width(alone[best])))
    mends = "state more of that, or add poses under other loads" if static else "state more of that"
    return say("hidden by", seen=seen, causes=f"{', '.join(names)}{how}", width=width, s=s[best], do=mends)


def mounting_words(posterior: Posterior) -> str:
    """How much k(s) differs between recordings."""
    if len(posterior.recordings) == 1:
        return say("one mounting")
    likely, low, high = posterior.mountings
    interval = f" ({100.0 * low:.2g} to {100.0 * high:.2g} %)" if high > low else ""
    return "" if np.isnan(likely) else say("mountings", likely=likely, span=interval)


def what_to_do(name: str, recordings: Sequence[Observations]) -> str:
    """A measure against this allowance; empty if there is none, or if it is stated already."""
    stated = [one.stated for one in recordings]
    by_hand = any(one.place_sd >= PLACE_SD for one in stated)
    uncalibrated = any(one.gain_sd >= GAIN_SD for one in stated)
    ways = {
        "place of the push": ("measure where the push acts: `at_sd_m`", by_hand),
        "stretch and shear": ("measure the thickness: `width_m`", any(np.isnan(one.thickness) for one in stated)),
        "stiff tags": ("thinner tags", True),
        FORCE_SCALE: ("calibrate the sensor with a weight: `gain_sd`", uncalibrated),
        "rest shape": ("measure the beam at rest: `rest_curvature_sd_deg`", True),
    }
    way, is_open = ways.get(name, ("", False))
    return way if is_open else ""


@dataclass(frozen=True)
class ModulusRows:
    """E and its band in one unit; `low` and `high` are empty without a band."""

    unit: str
    values: tuple[str, ...]
    low: tuple[str, ...]
    high: tuple[str, ...]


@dataclass(frozen=True)
class MeasuredBeam:
    """A learned beam, with band and section if known."""

    beam: Beam
    uncertain: UncertainStiffness | None
    section: StatedSection | None

    def band(self, s: Array) -> ModulusBand | None:
        """E at `s` (S,); None without a section."""
        return outcome.modulus_along(self.beam, self.uncertain, self.section, s)


def measured_beam(findings: run.Run) -> MeasuredBeam:
    uncertain = None if findings.posterior is None else findings.posterior.stiffness
    return MeasuredBeam(findings.beam, uncertain, outcome.stated_section(findings.recordings))


def modulus_rows(measured: MeasuredBeam, s: Array) -> ModulusRows | None:
    """E at `s` (S,); None without a section."""
    band = measured.band(s)
    if band is None:
        return None
    factor, unit = modulus_unit(band.modulus[outcome.shown_places(band)])
    columns = [
        tuple(significant(float(value)) for value in edge / factor) for edge in (band.modulus, band.low, band.high)
    ]
    return ModulusRows(unit, *(columns if measured.uncertain is not None else (columns[0], (), ())))


def one_modulus_words(measured: MeasuredBeam) -> str:
    """ "50.5 GPa (49.8 to 51.2)"; empty unless k(s) was learned as modulus times section."""
    found = one_modulus(measured.uncertain or measured.beam.stiffness, measured.beam.length, measured.section)
    if found is None:
        return ""
    factor, unit = modulus_unit(np.array(found[:1]))
    middle, low, high = (significant(value / factor) for value in found)
    return f"{middle}\u00a0{unit} ({low} to {high})"


def modulus_range(measured: MeasuredBeam) -> str:
    """ "0.68 … 0.73 MPa" where k(s) is identified; empty without a section."""
    band = measured.band(np.linspace(0.0, 1.0, 201))
    if band is None or not np.any(shown := outcome.shown_places(band)):
        return ""
    found = band.modulus[shown]
    factor, unit = modulus_unit(found)
    return f"{span(float(found.min()) / factor, float(found.max()) / factor, ' … ')}\u00a0{unit}"


def modulus_words(measured: MeasuredBeam) -> list[str]:
    """E in a sentence, with the section; empty without one."""
    section = measured.section
    if section is None:
        return []
    known = f"known to {significant(1e3 * section.sd, 2)} mm (sd)" if section.sd > 0.0 else "taken as exact"
    if section.moment_sd > 0.0:
        known = f"known to {significant(100.0 * section.moment_sd, 2)} % (sd)"
    found = modulus_range(measured) or "not known at any place"
    one = one_modulus_words(measured)
    found = f"{one}, 95 %, mean along the beam; {found} at its places" if one else found
    return [say("modulus", found=found, section=section, known=known)]
