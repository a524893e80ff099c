"""The verdict on k(s): what it is, what it rests on, what it is good for, and what to do next.

One function makes it, and terminal, report and `summary.json` say it in the same words.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from onebend.beam.stiffness import half_width_words
from onebend.errors import section
from onebend.learning.criticism import Suspect
from onebend.learning.frequencies import compared_frequencies, worst_off
from onebend.learning.outcome import Comparison
from onebend.learning.posterior import Grade, Posterior
from onebend.learning.verdict import cause_words, fitted_rms, possible
from onebend.records import Array, Observations
from onebend.report.confidence import (
    identified_ranges,
    identified_words,
    measured_beam,
    narrower_words,
    one_modulus_words,
    share_words,
    stiffness_range,
    typical_half_width,
    why_words,
)
from onebend.report.wording import (
    Findings,
    another_beam,
    millimetres,
    only_frequencies,
    poor_fit,
    significant,
    span,
    tag_words,
)

AS_GOOD = 1.5  # times the force noise: a sensor that is not better can show no better beam
_MOST_NAMED = 4  # allowances, tests
_NARROW, _MOST = 0.1, 0.9  # half-width of the band, identified share: with less, another push tells more
ErrorOf = Literal["validation", "fit", "as logged"]


@dataclass(frozen=True)
class Verdict:
    """Sentences without their full stops, and the one number that tells how far the beam is from the tags."""

    grade: Grade | Literal["no band"]
    headline: str  # the grade in a sentence, with what was allowed for or what is in doubt
    known: str  # k(s), and how well it is known
    rests_on: str
    use: str  # how far off its predictions are, and what that means
    narrower: str  # what to state for a narrower band; empty where nothing would help much
    next: str  # the one thing to do
    error: float  # m RMS of the worst tag; NaN: not known
    error_of: ErrorOf
    about: str = ""  # what is wrong with k(s), a key of `errors.SECTIONS`; "": nothing is

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        fields = asdict(self)
        kept = {name: value for name, value in fields.items() if name not in ("error", "about")}
        return kept | {"error_m": self.error, "docs": section(self.about)}

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """Label and words of all below the headline."""
        docs = (("docs", section(self.about)),) if self.about else ()
        rows = (("k(s)", self.known), ("rests on", self.rests_on), ("for use", self.use), ("narrower", self.narrower))
        return (*(row for row in rows if row[1]), ("next", self.next), *docs)


@dataclass(frozen=True)
class _Error:
    """The worst tag of the recordings that count."""

    of: ErrorOf
    rms: float  # m
    tag: str
    noise: float  # m, the force noise of it
    likely: float  # m, what that, the band of k(s) and the push's tolerances let expect
    motion: float  # m, how far the tag moves
    name: str
    failed: bool  # a warning says so


def verdict_of(findings: Findings) -> Verdict:
    """The verdict on a run."""
    error = _error(findings)
    posterior = findings.posterior
    return Verdict(
        grade="no band" if posterior is None else posterior.grade,
        headline=_headline(posterior),
        known=_known(findings),
        rests_on=_rests_on(posterior),
        use=_use(findings, error),
        narrower="" if posterior is None or posterior.doubts else narrower_words(posterior),
        next=_next(findings, error),
        error=error.rms,
        error_of=error.of,
        about=_about(findings.posterior),
    )


def _about(posterior: Posterior | None) -> str:
    """What the verdict itself finds wrong; warnings have sections of their own."""
    if posterior is None:
        return ""
    if posterior.doubts:
        return "not trusted"
    return "" if identified_ranges(posterior.stiffness) else "not identified"


def hopeless(findings: Findings) -> bool:
    """Whether the fit misses a recording so far that nothing that was fitted means anything."""
    return findings.posterior is not None and any(one.hopeless for one in findings.posterior.misses)


def _headline(posterior: Posterior | None) -> str:
    if posterior is None:
        return "k(s) by the paper's regression: it has no band, and nothing tests it"
    if posterior.doubts:
        return f"k(s) is NOT TO BE TRUSTED: {'; '.join(posterior.doubts)}"
    matter = [share_words(share) for share in posterior.attributions if share.matters]
    if not matter:
        return "k(s) holds: the beam and the bench are as the model has them"
    return f"k(s) holds with allowances: {', '.join(matter[:_MOST_NAMED])}"


def _known(findings: Findings) -> str:
    low, high = stiffness_range(findings)
    values = f"{span(low, high)} N m"
    if findings.posterior is None:
        return values
    if findings.posterior.doubts:
        return "no value that came out counts" if hopeless(findings) else f"{values} came out, with no band that holds"
    uncertain = findings.posterior.stiffness
    ranges = identified_ranges(uncertain)
    if not ranges:
        return f"{values}, not identified: at no place to a factor of 1.5 (95 %); {why_words(findings.posterior)}"
    wide = half_width_words(typical_half_width(uncertain))
    one = one_modulus_words(measured_beam(findings))
    headline = f"E = {one}, 95 %, times the section's I(s); " if one else ""
    return f"{headline}{values}, {wide} (95 %, median) over s = {identified_words(ranges)}"


def _rests_on(posterior: Posterior | None) -> str:
    if posterior is None:
        return "the equations (12) to (18) alone; `--method fit` gives a band and tests the model"
    if any(one.hopeless for one in posterior.misses):
        return "nothing: the fit misses the tags by far"
    critic = posterior.criticism
    tests = len(possible(posterior).criticism.able)
    if not tests and not critic.alarms:
        return "no test of the model: the data tell nothing of its other causes"
    count = f"{tests} tests of the model" if tests > 1 else "one test of the model"
    if critic.alarms:
        able = possible(posterior).criticism.alarms
        named = ", ".join(dict.fromkeys(_suspect_words(one.score.suspect) for one in able[:_MOST_NAMED]))
        return f"{count}: {_stand_out(len(critic.alarms))}" + (f" ({named})" if named else "")
    if critic.striking:
        return f"{count}: {_stand_out(len(critic.striking))}, but would hardly move k(s)"
    return f"{count}: none stands out"


def _suspect_words(suspect: Suspect) -> str:
    return f"tag {suspect.tag} {suspect.name}" if suspect.tag >= 0 else suspect.name


def _stand_out(count: int) -> str:
    return "1 stands out" if count == 1 else f"{count} stand out"


def _error(findings: Findings) -> _Error:
    """Of the validations, where there are any; else of the fit; else under the force as logged."""
    seen = [one for one in findings.validations if np.isfinite(one.rms).any()]  # not of frequencies alone
    if seen:
        return _worst("validation", seen, [one.rms for one in seen])
    if findings.posterior is not None:
        return _worst("fit", findings.trainings, fitted_rms(findings.posterior))
    return _worst("as logged", findings.trainings, [one.rms for one in findings.trainings])


def _worst(of: ErrorOf, comparisons: Sequence[Comparison], rms: Sequence[Array]) -> _Error:
    largest = [float(np.max(np.nan_to_num(values, nan=-1.0))) for values in rms]
    i = int(np.argmax(largest))
    one, values = comparisons[i], np.nan_to_num(rms[i], nan=-1.0)
    m = int(np.argmax(values))
    seen = one.measured[:, m]
    known = bool(np.isfinite(seen).any()) and values[m] >= 0.0
    motion = float(np.linalg.norm(np.fmax.reduce(seen) - np.fmin.reduce(seen))) if known else math.nan
    failed = of == "validation" and any(poor_fit(two, other=True) or another_beam(two) for two in comparisons)
    value = float(values[m]) if known else math.nan
    return _Error(
        of, value, tag_words(one, m), float(one.sensor_rms[m]), float(one.likely_rms[m]), motion, one.name, failed
    )


def _use(findings: Findings, error: _Error) -> str:
    if findings.posterior is not None and findings.posterior.doubts:
        return "none: no place of k(s) counts as identified"
    said = f"{millimetres(error.rms)} mm RMS (worst: {error.tag})"
    if error.of == "fit" and (poor := _poor(findings.trainings)) != "":
        return f"the fit is off by {said}, but {poor}: no good prediction"
    if findings.posterior is not None and only_frequencies(findings.recordings) and error.of != "validation":
        rows = compared_frequencies(findings.posterior.frequencies)
        off = significant(worst_off(findings.posterior.frequencies), 2)
        return f"the beam as fitted is within {off} sd of its {len(rows)} frequencies; not validated"
    if error.of != "validation":
        how = "the fit is off by" if error.of == "fit" else "off by"
        another = "pose" if findings.recordings[0].static else "push"
        return f"{how} {said}; not validated on another {another}"
    where = f"validation on {error.name}: {said}"
    part = f"{significant(100.0 * error.rms / error.motion, 2)} % of its motion"
    means = f"no good prediction, {part}" if error.failed else f"shapes are predicted to {part}"
    if not (math.isfinite(error.noise) and error.noise > 0.0):
        return f"{where}: {means}"
    explained = f"force noise {millimetres(error.noise)} mm"
    if error.rms <= AS_GOOD * error.noise and not error.failed:
        return f"{where}; {explained}: as good as this force sensor allows"
    if math.isfinite(error.likely):
        explained += f", with the band of k(s) and the push's place {millimetres(error.likely)} mm"
        if error.rms <= AS_GOOD * error.likely and not error.failed:
            means += ", as well as its band says"
    return f"{where}; {explained}: {means}"


def _poor(trainings: Sequence[Comparison]) -> str:
    """By how much the beam misses what it was learned from, under the force as logged; empty as a rule."""
    if not any(poor_fit(one) for one in trainings if not one.static):  # poses have no log; a wrong one is named apart
        return ""
    logged = _worst("as logged", trainings, [one.rms for one in trainings])
    moves = f"{logged.tag}, which moves by {significant(1e3 * logged.motion)}"
    return f"under the force as logged by {millimetres(logged.rms)} at {moves}"


def _next(findings: Findings, error: _Error) -> str:
    """The first that applies: mend what is wrong, validate, then learn more."""
    posterior, first = findings.posterior, findings.recordings[0]
    if posterior is None:
        return "learn with `--method fit`: it gives a band, and says where the push does not tell"
    if (mend := _mend(posterior)) != "":
        return mend
    if error.failed:
        return f"see that {error.name} is of this beam, then that the force and its place are right in both"
    if error.of != "validation":
        return _validate_words(first)
    if _known_well(posterior):
        return "nothing: use it (`onebend reach`, `shape`, `path`, `export`)"
    if first.source.clean_force is not None:
        return "`onebend plan` says which push would tell more of k(s)"
    return "add poses with a load at another place: they tell more of k(s)"


def _mend(posterior: Posterior) -> str:
    """What to do about the likeliest fault; empty where there is none."""
    hopeless = any(one.hopeless for one in posterior.misses)
    causes = possible(posterior).criticism.causes
    if causes and not hopeless and not posterior.criticism.trusted:
        what, do = cause_words(causes[0], posterior)
        return f"{do[:1].lower()}{do[1:]} (the likeliest cause: {what})"
    whose = [one.observations for one in posterior.recordings]
    for remark in (remark for one in whose for remark in one.source.remarks if remark.doubt):
        return remark.text.rstrip(".")
    if posterior.doubts:
        if all(one.static for one in whose):
            return "check the loads and their unit, then the points' axes (first of all the sign of y) and clamp_deg"
        return "check the sign and the axes of [force], then the clocks: `onebend check` shows both"
    if not posterior.criticism.trusted:
        film = "" if all(one.static for one in whose) else ", and at the film"
        return f"look at the residuals in the report{film}: no single cause explains them"
    return ""


def _validate_words(first: Observations) -> str:
    if only_frequencies([first]):
        return "measure it in another posture, or with a known tip_mass_kg, or hang a weight on it, and learn from both"
    if first.static:
        return "measure a pose under another load, and run `onebend validate` on it"
    return "film a second push (faster, elsewhere), and run `onebend validate`"


def _known_well(posterior: Posterior) -> bool:
    uncertain = posterior.stiffness
    share = sum(end - begin for begin, end in identified_ranges(uncertain))
    return share >= _MOST and typical_half_width(uncertain) <= _NARROW
