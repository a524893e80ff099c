"""Allowances in words: each with its share, and what would narrow the band."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform
from onebend.learning.attribution import FORCE_SCALE, GROUPS, Attribution
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import fit
from onebend.learning.start import start_of
from onebend.recording.observe import observe
from onebend.records import GAIN_SD, PLACE_SD, Observations
from onebend.report.confidence import narrower_words, share_words, what_to_do, why_words
from onebend.report.verdict import verdict_of
from tests import made_up
from tests.recording.tracked import ROD_S, pose_folder


def share(widening: float = 1.0, shift: float = 0.0, sds: float = 0.0) -> Attribution:
    return Attribution("relaxation", widening, shift, sds, max(shift, 0.01), 0.05)


@pytest.mark.parametrize(
    ("one", "words"),
    [
        (share(), "relaxation (ignoring it could shift k(s) by 1 %)"),
        (share(shift=0.1, sds=1.0), "relaxation (ignoring it could shift k(s) by 11 %)"),  # or it is chance
        (share(shift=0.1, sds=5.0), "relaxation (ignoring it would shift k(s) by 11 %)"),
        (share(shift=2.0, sds=5.0), "relaxation (ignoring it would give a completely different k(s))"),
        (share(widening=1.25), "relaxation (band 1.25 times as wide)"),
        (share(1.25, 0.1, 5.0), "relaxation (ignoring it would shift k(s) by 11 %, band 1.25 times as wide)"),
    ],
)
def test_a_share_is_what_the_data_show_and_what_it_costs(one: Attribution, words: str) -> None:
    assert share_words(one) == words


def seen(**stated: float) -> list[Observations]:
    return [made_up.with_stated(made_up.observations(), **stated)]


def test_what_is_stated_is_not_asked_for_again() -> None:
    assert "`at_sd_m`" in what_to_do("place of the push", seen(place_sd=PLACE_SD))
    assert what_to_do("place of the push", seen(place_sd=0.2 * PLACE_SD)) == ""
    assert "`gain_sd`" in what_to_do(FORCE_SCALE, seen(gain_sd=GAIN_SD))
    assert what_to_do(FORCE_SCALE, seen(gain_sd=0.2 * GAIN_SD)) == ""
    assert "`width_m`" in what_to_do("stretch and shear", seen(thickness=float("nan")))
    assert what_to_do("stretch and shear", seen(thickness=0.012)) == ""
    assert {name for name in (*GROUPS, FORCE_SCALE) if what_to_do(name, seen(gain_sd=GAIN_SD, place_sd=PLACE_SD))} == {
        "place of the push",
        "stretch and shear",
        "stiff tags",
        FORCE_SCALE,
        "rest shape",
    }


def test_the_two_that_widen_the_band_most_are_to_be_measured() -> None:
    found = made_up.posterior()
    whole = tuple(
        replace(one, observations=made_up.with_stated(one.observations, gain_sd=0.0)) for one in found.recordings
    )
    uncertain = replace(found, gain_sd=1.0, problem=replace(found.problem, recordings=whole))
    assert "`gain_sd`" not in narrower_words(uncertain)  # stated, and better than the usual
    known = replace(found, gain_sd=0.0)
    widest = [a for a in sorted(known.attributions, key=lambda a: -a.widening) if a.matters and a.widening > 1.1]
    told = [what_to_do(a.name, [one.observations for one in found.recordings]) for a in widest]
    words = narrower_words(known)
    assert all(what in words for what in [one for one in told if one][:2])
    assert words.count("up to") == min(len([one for one in told if one]), 2)


def test_the_verdict_names_each_allowance_with_its_share() -> None:
    findings = made_up.findings(1)
    assert findings.posterior is not None
    verdict = verdict_of(findings)
    matter = [a for a in findings.posterior.attributions if a.matters]
    assert matter
    assert verdict.headline == f"k(s) holds with allowances: {', '.join(share_words(a) for a in matter[:4])}"
    assert dict(verdict.rows).get("improve", "") == verdict.narrower == narrower_words(findings.posterior)
    assert "improve" not in dict(verdict_of(made_up.findings(0, fitted=False)).rows)


@pytest.mark.parametrize(
    ("sd", "free", "words"),
    [
        (1e-3, 'rest = "unknown"', ["one pose does not separate it from rest shape", "add poses under other loads"]),
        (
            0.2,
            'rest = "straight"',
            ["one pose does not determine it even if all else were known: bend the beam further"],
        ),
    ],
)
def test_one_pose_says_why_it_does_not_tell_k(tmp_path: Path, sd: float, free: str, words: list[str]) -> None:
    """A rod with one weight: its rest shape may be what bends it, or the points are too rough."""
    rod = Beam(0.5, Uniform(0.3))
    shown = rod.equilibrium(np.array([[0.0, -0.2]])).xy(ROD_S)
    o = observe(
        pose_folder(
            tmp_path,
            loads="pose,s,fy_N\n0,1,-0.2\n",
            gravity="",
            shown=np.asarray(shown).reshape(1, 5, 2),
            beam=f"{free}\nrest_curvature_sd_deg = 40\n" if "unknown" in free else f"{free}\n",
            poses=f"sd_m = {sd}\n",
        )
    )
    said = why_words(fit([o], start_of([o], None), settings=FitSettings(functions=10)))
    assert all(word in said for word in words), said
