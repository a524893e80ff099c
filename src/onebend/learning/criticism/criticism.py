"""Does the fit's own model hold? Score tests of what may be otherwise, and what they make of the band.

The band of k(s) is right only if the model is. `criticise` tests the model against a list of alternatives
(`alternatives.py`) and against every prior, each by a score test (`score_tests.py`). Where a test is more striking than
any in clean recordings, the band is not to be trusted, and the suspects that explain the misfit best are named. The
band is not widened: a wrong model moves k(s) by an unknown amount, and `Criticism.widening` covers only the part that
the named cause accounts for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.learning.criticism.alternatives import alternatives
from onebend.learning.criticism.score_tests import Score, linearised, pulls, scores
from onebend.learning.inference.fit_problem import FitProblem
from onebend.learning.inference.optimizer import Optimum
from onebend.records import Array
from onebend.workers import each

# log10 p of one test of about 45: under one false alarm in 2,000 recordings. Beyond it, k(s) must move too to count.
ALARM = -5.0
# The same of what a person writes down of the push, its sensor and the section: it is wrong more often than beams are
# odd, and hardly shows.
ALARM_WRITTEN = -2.5
WRITTEN = ("push place", "force direction", "axis scale", "stiffness along")
_AS_LIKELY = 10.0  # of -2 log p: a cause that explains less than the best by no more is named beside it
_SHARE = 0.8  # of the best cause's gain: the same, where the misfit is large
_MOST_NAMED = 3  # causes and symptoms that are named
_MATTERS = 0.5  # sd of log k: a smaller shift lowers the coverage of a 95 % band to 92 % at most, and gets a note only


@dataclass(frozen=True)
class Finding:
    """One test, with what it means for k(s)."""

    score: Score
    shift: float  # largest change of log k over the identified places if it is freed
    sds: float  # the same in sds of log k

    @property
    def matters(self) -> bool:
        """Whether the change is no small part of the band, as that would be without the misfit's share of its noise."""
        return bool(self.sds * np.sqrt(self.score.noise) > _MATTERS)


@dataclass(frozen=True)
class Criticism:
    """All tests, the most striking first."""

    findings: tuple[Finding, ...]
    alarm: float = ALARM  # log10 p beyond which a test counts

    @property
    def able(self) -> tuple[Finding, ...]:
        """Those of which the data tell anything."""
        return tuple(f for f in self.findings if f.score.able)

    @property
    def striking(self) -> tuple[Finding, ...]:
        """Those that clean recordings do not show."""
        return tuple(f for f in self.findings if f.score.log10_p < self.level(f))

    def level(self, finding: Finding) -> float:
        """log10 p beyond which one test counts."""
        return max(self.alarm, ALARM_WRITTEN) if finding.score.suspect.name in WRITTEN else self.alarm

    @property
    def alarms(self) -> tuple[Finding, ...]:
        """Those of them that put k(s) in doubt."""
        return tuple(f for f in self.striking if f.matters)

    @property
    def trusted(self) -> bool:
        """Whether the band may be relied on, as far as the recording itself can tell."""
        return not self.alarms

    @property
    def causes(self) -> tuple[Finding, ...]:
        """What would explain the misfit, freed by itself: the best first, and those that are about as good."""
        able = sorted((f for f in self.alarms if f.score.suspect.kind != "trend"), key=lambda f: -f.score.gain)
        if not able:
            return ()
        most = able[0].score.gain
        least = min(most - _AS_LIKELY, _SHARE * most)
        return tuple(f for f in able if f.score.gain >= least)[:_MOST_NAMED]

    @property
    def symptoms(self) -> tuple[Finding, ...]:
        """Tags and coordinates whose residuals are no noise, the largest first."""
        trends = [f for f in self.alarms if f.score.suspect.kind == "trend"]
        return tuple(sorted(trends, key=lambda f: -f.score.size))[:_MOST_NAMED]

    @property
    def widening(self) -> float:
        """Factor on the band that would make it hold k(s) as it comes out with the best cause freed; 1 where trusted,
        NaN where no cause is known."""
        if self.trusted:
            return 1.0
        return float(np.hypot(1.0, self.causes[0].sds)) if self.causes else np.nan

    def as_dict(self) -> dict[str, Any]:
        """For JSON: the verdict, and every test."""
        return {
            "trusted": self.trusted,
            "alarm_log10_p": self.alarm,
            "widening": self.widening,
            "causes": [_as_dict(f) for f in self.causes],
            "symptoms": [_as_dict(f) for f in self.symptoms],
            "tests": [_as_dict(f) for f in self.findings],
        }


def criticise(problem: FitProblem, optimum: Optimum, stiffness: UncertainStiffness) -> Criticism:
    """Test the model of a fit that has ended."""
    fit, layout = linearised(problem, optimum), problem.layout
    patterns = each(lambda now: alternatives(now.recording, layout, optimum.x, now), optimum.predictions)
    tests = [*scores(fit, patterns), *pulls(fit)]
    s = np.linspace(0.0, 1.0, 101)
    identified = stiffness.band(s).identified
    s = s[identified] if np.any(identified) else s
    sd, basis = stiffness.log_at(s)[1], layout.spline.basis(s)
    findings = [_finding(score, basis @ score.shift, sd) for score in tests]
    return Criticism(tuple(sorted(findings, key=lambda f: f.score.log10_p)))


def _finding(score: Score, shift: Array, sd: Array) -> Finding:
    return Finding(score, float(np.max(np.abs(shift))), float(np.max(np.abs(shift) / sd)))


def _as_dict(finding: Finding) -> dict[str, Any]:
    score, suspect = finding.score, finding.score.suspect
    return {
        "kind": suspect.kind,
        "name": suspect.name,
        "tag": suspect.tag if suspect.tag >= 0 else None,
        "recording": suspect.recording or None,
        "value": score.value,
        "sd": score.sd,
        "gain": score.gain,
        "log10_p": score.log10_p,
        "size_m": score.size,
        "shift_log_k": finding.shift,
        "shift_sds": finding.sds,
        "matters": finding.matters,
    }
