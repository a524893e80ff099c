"""The verdict on k(s), for terminal, report and `summary.json`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from onebend.beam.stiffness import half_width_words
from onebend.errors import section
from onebend.learning.frequencies import compared_frequencies, worst_off
from onebend.learning.outcome import Comparison, another_beam, motion_of, poor_fit
from onebend.learning.posterior import Grade, Posterior
from onebend.learning.run import Run
from onebend.learning.verdict import cause, fitted_rms, possible
from onebend.records import Array, Observations, Remark
from onebend.report import confidence
from onebend.report.sentences import (
    SENTENCES,
    all_remarks,
    is_forced,
    millimetres,
    only_frequencies,
    remedy,
    say,
    significant,
    span,
    tag_words,
)

AS_GOOD = 1.5  # times the force noise: a better beam would not show
_MOST_NAMED = 4  # allowances, tests
_OF_UNITS = ("force unit", "no material")  # what warnings of a wrong unit are about
_NARROW, _MOST = 0.1, 0.9  # half-width, identified share: below, another push is worthwhile
ErrorOf = Literal["validation", "fit", "as logged"]


@dataclass(frozen=True)
class Verdict:
    """Sentences without full stops, and one error."""

    grade: Grade | Literal["no band"]
    headline: str  # grade, with allowances or doubts
    known: str  # k(s) and its band
    rests_on: str  # tests of the model
    given: str  # statements that no test can see to be wrong
    use: str  # error of predictions, and its meaning
    narrower: str  # how to narrow the band; empty if nothing helps much
    next: str  # one action
    error: float  # m RMS of the worst tag, or NaN
    error_of: ErrorOf
    about: str = ""  # key of `sections.toml`, or ""

    def as_dict(self) -> dict[str, Any]:
        fields = asdict(self)
        kept = {name: value for name, value in fields.items() if name not in ("error", "about")}
        return kept | {"error_m": self.error, "docs": section(self.about)}

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """Labels and sentences below the headline."""
        docs = (("docs", section(self.about)),) if self.about else ()
        rows = (
            ("k(s)", self.known),
            ("tests", self.rests_on),
            ("rests on", self.given),
            ("accuracy", self.use),
            ("improve", self.narrower),
        )
        return (*(row for row in rows if row[1]), ("next", self.next), *docs)


@dataclass(frozen=True)
class _Error:
    of: ErrorOf
    rms: float  # m
    tag: str
    noise: float  # m, force noise
    likely: float  # m, from force noise, band of k(s) and tolerances of the push
    motion: float  # m, of the tag
    name: str
    failed: bool  # a warning says so


def verdict_of(findings: Run) -> Verdict:
    error = _error(findings)
    posterior = findings.posterior
    return Verdict(
        grade="no band" if posterior is None else posterior.grade,
        headline=_headline(posterior),
        known=_known(findings),
        rests_on=_rests_on(posterior),
        given=_given(findings.recordings),
        use=_use(findings, error),
        narrower="" if posterior is None or posterior.doubts else confidence.narrower_words(posterior),
        next=_next(findings, error),
        error=error.rms,
        error_of=error.of,
        about=_about(posterior),
    )


def _about(posterior: Posterior | None) -> str:
    if posterior is None:
        return ""
    code = "verdict: doubt" if posterior.doubts else "known: nowhere"
    return "" if not posterior.doubts and confidence.identified_ranges(posterior.stiffness) else SENTENCES[code].about


def hopeless(findings: Run) -> bool:
    """Whether the fit misses a recording so far that no estimate is meaningful."""
    return findings.posterior is not None and any(one.hopeless for one in findings.posterior.misses)


def _headline(posterior: Posterior | None) -> str:
    if posterior is None:
        return say("verdict: regression")
    if posterior.doubts:
        return say("verdict: doubt", doubts="; ".join(posterior.doubts))
    if not confidence.identified_ranges(posterior.stiffness):
        return say("verdict: nowhere")
    matter = [confidence.share_words(share) for share in posterior.attributions if share.matters][:_MOST_NAMED]
    return say("verdict: allowances", allowances=", ".join(matter)) if matter else say("verdict: holds")


def _known(findings: Run) -> str:
    low, high = confidence.stiffness_range(findings)
    values = f"{span(low, high)} N m"
    if findings.posterior is None:
        return values
    if findings.posterior.doubts:
        return say("known: nothing") if hopeless(findings) else say("known: no band", values=values)
    uncertain = findings.posterior.stiffness
    ranges = confidence.identified_ranges(uncertain)
    if not ranges:
        return say("known: nowhere", values=values, why=confidence.why_words(findings.posterior))
    width = half_width_words(confidence.typical_half_width(uncertain))
    k = say("known: band", values=values, width=width, places=confidence.identified_words(ranges))
    modulus = confidence.one_modulus_words(confidence.measured_beam(findings))
    return say("known: modulus", modulus=modulus, k=k) if modulus else k


def _rests_on(posterior: Posterior | None) -> str:
    if posterior is None:
        return say("rests: regression")
    if any(one.hopeless for one in posterior.misses):
        return say("rests: nothing")
    critic, able = posterior.criticism, possible(posterior).criticism
    tests = len(able.able)
    if not tests and not critic.alarms:
        return say("rests: no test")
    count = f"{tests} tests of the model" if tests > 1 else "one test of the model"
    if critic.alarms:
        suspects = [one.score.suspect for one in able.alarms[:_MOST_NAMED]]
        names = dict.fromkeys(f"tag {one.tag} {one.name}" if one.tag >= 0 else one.name for one in suspects)
        named = f" ({', '.join(names)})" if names else ""
        return say("rests: alarms", tests=count, some=_stand_out(len(critic.alarms)), named=named)
    if critic.striking:
        return say("rests: striking", tests=count, some=_stand_out(len(critic.striking)))
    return say("rests: tests", tests=count)


def _given(recordings: Sequence[Observations]) -> str:
    """The facts on which the size of k(s) depends, as stated."""
    first, weighed = recordings[0], bool(np.isfinite(recordings[0].stated.mass))
    facts = []
    if any(map(is_forced, recordings)):
        size = max(float(np.nanmax(np.linalg.norm(one.force, axis=1), initial=0.0)) for one in recordings)
        facts.append(say("given: loads" if first.static else "given: force", force=significant(size)))
    if not first.static and facts:
        facts.append(say("given: place", place=span(float(np.nanmin(first.push_s)), float(np.nanmax(first.push_s)))))
    facts.append(say("given: length", length=first.length))
    if pulled := [np.degrees(np.arctan2(*one.gravity.T[::-1])) for one in recordings if np.any(one.gravity)]:
        if weighed:
            facts.append(say("given: mass", mass=first.stated.mass))
        turn = np.round(np.concatenate(pulled), 1) + 0.0  # no -0
        facts.append(say("given: gravity", turn=span(float(np.min(turn)), float(np.max(turn)))))
    elif facts and not only_frequencies(recordings):
        facts.append(say("given: no weight"))
    return ", ".join(facts)


def _stand_out(count: int) -> str:
    return "1 stands out" if count == 1 else f"{count} stand out"


def _error(findings: Run) -> _Error:
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
    known = bool(np.isfinite(one.measured[:, m]).any()) and values[m] >= 0.0
    motion = float(motion_of(one)[m]) if known else math.nan
    failed = of == "validation" and any(poor_fit(two, other=True) or another_beam(two) for two in comparisons)
    value = float(values[m]) if known else math.nan
    return _Error(
        of, value, tag_words(one, m), float(one.sensor_rms[m]), float(one.likely_rms[m]), motion, one.name, failed
    )


def _use(findings: Run, error: _Error) -> str:
    posterior = findings.posterior
    if posterior is not None and posterior.doubts:
        return say("use: none")
    worst = f"{millimetres(error.rms)} mm RMS (worst: {error.tag})"
    # Poses have no log; wrong ones have their own warning.
    if error.of == "fit" and any(poor_fit(one) for one in findings.trainings if not one.static):
        logged = _worst("as logged", findings.trainings, [one.rms for one in findings.trainings])
        numbers = {"logged": millimetres(logged.rms), "tag": logged.tag, "motion": significant(1e3 * logged.motion)}
        return say("use: poor", error=worst, **numbers)
    if posterior is not None and only_frequencies(findings.recordings) and error.of != "validation":
        rows = compared_frequencies(posterior.frequencies)
        return say("use: frequencies", off=significant(worst_off(posterior.frequencies), 2), count=len(rows))
    if error.of != "validation":
        kind = "pose" if findings.recordings[0].static else "push"
        return say("use: fit" if error.of == "fit" else "use: logged", error=worst, kind=kind)
    return _validated(error)


def validation_verdict(comparisons: Sequence[Comparison]) -> str:
    """What validations say of a beam, in one line; empty where nothing was seen."""
    seen = [one for one in comparisons if np.isfinite(one.rms).any()]
    own = [one.name for one in comparisons for remark in one.remarks if getattr(remark, "code", "") == "no validation"]
    if own:
        return say("validated: own data", recording=own[0])
    return _validated(_worst("validation", seen, [one.rms for one in seen])) if seen else ""


def _validated(error: _Error) -> str:
    values = {"recording": error.name, "error": f"{millimetres(error.rms)} mm RMS (worst: {error.tag})"}
    share = f"{significant(100.0 * error.rms / error.motion, 2)} % of its motion"
    meaning = f"no good prediction, {share}" if error.failed else f"shapes are predicted to {share}"
    if not (math.isfinite(error.noise) and error.noise > 0.0):
        return say("use: validated", noise="", meaning=meaning, **values)
    noise = f"; force noise {millimetres(error.noise)} mm"
    if error.rms <= AS_GOOD * error.noise and not error.failed:
        return say("use: as good", noise=noise, **values)
    if math.isfinite(error.likely):
        noise += f", with the band of k(s) and the push's place {millimetres(error.likely)} mm"
        if error.rms <= AS_GOOD * error.likely and not error.failed:
            meaning += ", as well as its band says"
    return say("use: validated", noise=noise, meaning=meaning, **values)


def _next(findings: Run, error: _Error) -> str:
    posterior, first = findings.posterior, findings.recordings[0]
    if posterior is None:
        return say("next: fit")
    warnings = [remark for _, remark in all_remarks(findings) if remark.level == "warning"]
    if (correction := _correction(posterior, warnings)) != "":
        return correction
    if error.failed:
        return say("next: same beam", recording=error.name)
    if error.of != "validation":
        if only_frequencies([first]):
            return say("next: another posture")
        return say("next: another pose" if first.static else "next: another push")
    if _known_well(posterior):
        return say("next: use it")
    return say("next: more poses" if first.source.clean_force is None else "next: plan")


def _correction(posterior: Posterior, warnings: Sequence[Remark]) -> str:
    """What to correct first: what a warning says of the doubts, then the likeliest cause, then a unit."""
    data = [one.observations for one in posterior.recordings]
    seen = [remark for one in data for remark in one.source.remarks if remark.level == "warning"]
    largest = posterior.contradictions[0].about if posterior.doubts and posterior.contradictions else ""
    accused = posterior.place is not None and posterior.place.accused
    doubted = [
        *(one for one in warnings if largest and one.about == largest),
        *(one for one in seen if one.doubt),
        *(one for one in warnings if accused and one.about == "push place"),
    ]
    if doubted:
        return doubted[0].text.rstrip(".")
    causes, trusted = possible(posterior).criticism.causes, posterior.criticism.trusted
    if causes and not trusted and not any(one.hopeless for one in posterior.misses):
        likeliest = cause(causes[0], posterior)
        do = remedy(likeliest)
        return say("next: cause", do=f"{do[:1].lower()}{do[1:]}", cause=likeliest)
    units = [one for one in (*seen, *warnings) if one.about in _OF_UNITS]
    if suspects := [*units, *(seen if posterior.doubts else [])]:
        return suspects[0].text.rstrip(".")
    static = all(one.static for one in data)
    if posterior.doubts:
        return say("next: poses" if static else "next: force")
    if not trusted:
        return say("next: residuals of poses" if static else "next: residuals")
    return ""


def _known_well(posterior: Posterior) -> bool:
    uncertain = posterior.stiffness
    share = sum(end - begin for begin, end in confidence.identified_ranges(uncertain))
    return share >= _MOST and confidence.typical_half_width(uncertain) <= _NARROW
