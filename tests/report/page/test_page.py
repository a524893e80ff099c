"""The page: self-contained, escaped, and with the figures of the records."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from onebend import __version__
from onebend.learning.fit_data import FitData
from onebend.learning.outcome import another_beam, poor_fit
from onebend.learning.verdict import fitted_rms
from onebend.recording.video import KeptFrames
from onebend.records import POINT_ID, ClockOffset, Remark
from onebend.report.confidence import alarm_words, stiffness_range, tradeoff_words, unidentified_words
from onebend.report.figures import Shown, draw_all, fit
from onebend.report.page import cards, code_in, page
from onebend.report.sentences import (
    all_remarks,
    assumptions,
    axis_words,
    change_words,
    clock_words,
    inputs,
    legend_words,
    millimetres,
    pair_remarks,
    significant,
    worded,
    worst_tag,
)
from tests import made_up
from tests.made_up import with_source, with_stated

PNG = b"\x89PNG not really"


class Links(HTMLParser):
    """Every address the page would fetch, and its text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.text = ""  # that a person reads
        self.element = ""
        self.feed(html)

    def handle_starttag(
        self,
        tag: str,
        attrs: list[tuple[str, str | None]],
    ) -> None:
        self.element = tag
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]
        self.ids += [value or "" for name, value in attrs if name == "id"]

    def handle_data(self, data: str) -> None:
        if self.element not in ("style", "script"):
            self.text += data

    def handle_endtag(self, tag: str) -> None:  # noqa: ARG002
        self.element = ""


@pytest.fixture(scope="module")
def drawn() -> dict[str, bytes]:
    return draw_all(made_up.findings(2)).drawn


def test_every_figure_of_the_findings_is_drawn_and_shown(drawn: dict[str, bytes]) -> None:
    expected = {
        "stiffness",
        "shapes",
        "markers",
        "residuals",
        "fitted",
        "force",
        "validation",
    }
    expected |= {f"validation-{i}-{what}" for i in (1, 2) for what in ("shapes", "residuals")}
    assert set(drawn) == expected  # and no fit: there is no video
    links = Links(page(made_up.findings(2), drawn))
    assert sum(address.startswith("data:image/png;base64,") for address in links.addresses) == len(expected)


def test_nothing_is_fetched_and_every_anchor_leads_somewhere() -> None:
    html = page(made_up.findings(2), {"stiffness": PNG})
    links = Links(html)
    assert all(address.startswith(("data:", "#")) for address in links.addresses)
    assert {address[1:] for address in links.addresses if address.startswith("#")} <= set(links.ids)
    assert not re.search(r"https?://|@import|url\(", html)


def test_page_says_the_figures() -> None:
    found = made_up.findings(2)
    text = Links(page(found, {})).text
    fit = made_up.posterior()
    k = fit.beam.stiffness(np.linspace(0, 1, 201))[fit.band(np.linspace(0, 1, 201)).identified]
    for words in (
        f"onebend {__version__}",
        "n = 4 curvature modes",
        f"{significant(k.min())} … {significant(k.max())}\u00a0N\u00a0m",
        f"{millimetres(float(np.nanmax(fitted_rms(fit)[0])))}\u00a0mm (tag\u00a0",
        millimetres(float(found.trainings[0].rms[0])),  # as logged, folded below
        "between a growing and a falling force",  # nothing is said of its sensor, and its log wanders
        "made-up: clamp angle",
        f"converged after {fit.optimum.steps} steps",
        *unidentified_words(fit.stiffness),
        *tradeoff_words(fit),
        "k(s) is not positive",
        "other-2",
        "tag 3 was hidden for 2 frames",
        "254.310 s ± 4.0 ms",
        "1.00, – mN/s",
    ):
        assert words in text, words


def test_names_from_files_cannot_become_markup() -> None:
    found = made_up.findings(1)
    evil = "<script>alert(1)</script>"
    seen = with_source(found.recordings[0], name=evil, remarks=(Remark("warning", evil),))
    html, clean = (page(one, {}) for one in (replace(found, recordings=(seen,)), found))
    assert html.count("<script") == clean.count("<script") == 2  # the page's own, and its numbers
    assert evil not in html
    assert "&lt;script&gt;" in html


def test_points_of_an_outline_are_no_rows_of_tags() -> None:
    """They stand before the tags, in the order of their places."""
    found = made_up.findings(1)
    one = found.recordings[0]
    first = np.concatenate([[0], np.arange(len(one.tag_id))])
    names = ("tag_id", "marker_s", "rest_xy", "rest_angle", "rest_covariance")
    doubled = {name: getattr(one, name)[first] for name in names}
    doubled |= {name: getattr(one, name)[:, first] for name in ("xy", "angle", "covariance")}
    doubled["tag_id"] = np.concatenate([[POINT_ID + 50], one.tag_id])
    outlined = replace(one, traced=np.arange(len(first)) == 0, **doubled)
    text = Links(page(replace(found, recordings=(outlined,)), {})).text
    assert str(POINT_ID + 50) not in text
    assert all(f"tag {i}" in text for i in one.tag_id)


def test_points_of_an_outline_go_by_their_places() -> None:
    one = made_up.comparison()
    points = replace(one, tag_id=POINT_ID + np.arange(len(one.tag_id)))
    assert axis_words(one.tag_id.tolist()) == ["tag 1", "2", "3"]
    assert axis_words(points.tag_id.tolist()) == ["outline", "", ""]
    assert (legend_words(one, 2), legend_words(one, 2, place=True)) == ("tag 3", f"tag 3, s = {one.marker_s[2]:.3g}")
    assert legend_words(points, 2) == legend_words(points, 2, place=True) == f"s = {one.marker_s[2]:.3g}"


@pytest.mark.parametrize("fitted", [pytest.param(True, marks=pytest.mark.slow), False])
def test_bare_findings_make_a_page_without_empty_sections(fitted: bool) -> None:
    found = made_up.findings(0, fitted=fitted)
    seen = with_stated(
        with_source(found.recordings[0], clean_force=None, clock=None, view=None, remarks=()), rest="unknown"
    )
    bare = replace(found, recordings=(seen,), remarks=())
    bare = replace(bare, learned=None) if fitted else bare  # the regression found no beam
    links = Links(page(bare, draw_all(bare).drawn))
    assert "Validation" not in links.text
    assert ("Nuisances" in links.text) == fitted
    assert ("how n and m were chosen" in links.text) != fitted
    assert ("m g" in links.text) == fitted
    assert "There are no remarks" in links.text
    assert "nan" not in links.text.split()


def test_a_fit_without_its_video_is_left_out(tmp_path: Path) -> None:
    found = made_up.findings(0)
    one = Shown(found.beam, found.trainings[0], with_source(found.recordings[0], video=tmp_path / "gone.mp4"))
    assert fit(one, KeptFrames()) is None
    assert fit(replace(one, observations=with_source(found.recordings[0], view=None)), KeptFrames()) is None


def test_remarks_come_once_and_warnings_first() -> None:
    found = made_up.findings(1)
    remarks = all_remarks(replace(found, remarks=found.recordings[0].source.remarks))
    assert [remark.level for _, remark in remarks] == sorted((r.level for _, r in remarks), key="warning note".index)
    assert (
        len(remarks) == len({(whose, remark.text) for whose, remark in remarks}) == 5
    )  # one is on the poor fit of other-1


def test_a_poor_fit_is_a_warning() -> None:
    good = made_up.comparison()
    assert poor_fit(good) == ()
    far = made_up.comparison(error_m=0.02)
    assert [remark.level for remark in worded(poor_fit(far))] == ["warning"]
    assert "misses tag 1 by" in worded(poor_fit(far))[0].text  # which moves least
    assert "the beam that was learned" not in worded(poor_fit(far))[0].text
    assert "the beam that was learned" in pair_remarks(far, made_up.observations())[-1].text
    unseen = replace(good, measured=np.full_like(good.measured, np.nan), rms=np.full(3, np.nan))
    assert poor_fit(unseen) == ()
    assert another_beam(unseen) == ()


def test_a_validation_far_beyond_the_noise_is_a_warning() -> None:
    unknown = np.full(3, np.nan)
    noisy = made_up.comparison(error_m=0.0006)
    noisy = replace(noisy, sensor_rms=np.array([0.0003, 0.004, np.nan]), likely_rms=unknown)
    assert another_beam(noisy) == ()
    quiet = replace(noisy, sensor_rms=np.array([0.00005, 0.004, np.nan]))
    (said,) = worded(another_beam(quiet))
    assert said.level == "warning"
    assert "tag 1 is missed by 10 times the force noise" in said.text
    assert another_beam(made_up.comparison(error_m=1e-6)) == ()  # next to nothing, whatever explains it
    other = replace(made_up.findings(1), validations=(quiet,))
    assert any("another beam" in remark.text for _, remark in all_remarks(other))
    alone = replace(made_up.findings(0), trainings=(quiet,))
    assert not any("another beam" in remark.text for _, remark in all_remarks(alone))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0412345, "0.0412"),
        (0.051, "0.0510"),
        (6182.3, "6180"),
        (1.0, "1.00"),
        (-0.0213, "-0.0213"),
        (0.0, "0"),
        (9.9999, "10.0"),
        (1.5e-7, "1.5e-07"),
        (2e9, "2e+09"),
        (float("nan"), "–"),
        (float("inf"), "–"),
    ],
)
def test_significant(value: float, text: str) -> None:
    assert significant(value) == text


def test_small_words() -> None:
    assert millimetres(0.0012345) == "1.23"
    assert millimetres(3.93e-5) == "0.039"  # 0.04 says less than the fit knows, 0.00 of 4.2 um nothing
    assert millimetres(4.2e-6) == "0.0042"
    assert millimetres(0.0) == "0.00"
    assert worst_tag(replace(made_up.comparison(), rms=np.full(3, np.nan))) == "–"


def test_cards_count_the_recordings_and_keep_to_what_is_identified() -> None:
    one, two = made_up.findings(1), made_up.findings(2)
    notes = [" ".join(note for _, _, note in cards(found)) for found in (one, two)]
    assert f"RMS, on {one.validations[0].name}" in notes[0]
    assert "worst of 2 other recordings" in notes[1]
    assert one.posterior is not None
    known = one.posterior.band(np.linspace(0.0, 1.0, 201)).identified
    low, high = stiffness_range(one)
    inside = one.beam.stiffness(np.linspace(0.0, 1.0, 201))[known]
    assert (low, high) == (inside.min(), inside.max())
    assert f"{significant(low)} … {significant(high)}" in cards(one)[0][1]


def test_the_page_says_from_where_on_a_test_counts() -> None:
    found = made_up.findings(1)
    assert found.posterior is not None
    text = Links(page(found, {})).text
    assert alarm_words(found.posterior) in text
    assert "1 in 100 000 (1 in 320 " in alarm_words(found.posterior)
    assert "the recording itself can show" in text


def test_a_clock_that_was_not_found_says_so() -> None:
    assert "could not settle it" in clock_words(ClockOffset(1.0, 2.0, 1.0, found=False))
    assert "from the written" not in clock_words(ClockOffset(1.0, 0.01, float("nan"), found=True))


def test_gravity_and_uncalibrated_cameras_are_said() -> None:
    seen = made_up.observations()
    assert seen.source.view is not None
    heavy = with_source(replace(seen, gravity=seen.gravity - 9.81), view=replace(seen.source.view, calibrated=False))
    assert "weight acts in the plane" in assumptions(replace(made_up.findings(0), recordings=(heavy,)))[0]
    assert any("not calibrated" in text for _, text in inputs(heavy))


def test_a_band_that_is_not_to_be_trusted_is_marked() -> None:
    found = made_up.findings(1)
    assert found.posterior is not None
    clean = Links(page(found, {})).text
    assert "this band is not to be trusted" not in clean
    assert "The tests notice only errors above" in clean
    assert "Verdict: k(s) holds" in clean
    critic = found.posterior.criticism
    worst = critic.findings[0]
    score = replace(worst.score, log10_p=-30.0)
    for sds in (1.0, 9.0):
        doubted = replace(critic, findings=(replace(worst, score=score, sds=sds), *critic.findings[1:]))
        tested = replace(found, posterior=replace(found.posterior, criticism=doubted))
        text = Links(page(tested, {})).text
        assert "1 in 1 000 000 000 or less" in text
        assert "stand out from what clean recordings show" in text
        assert ("this band is not to be trusted" in text) == (sds > 2.0)  # one that the band covers is marked, no more
    stopped = replace(found.posterior, optimum=replace(found.posterior.optimum, converged=False))
    text = Links(page(replace(found, posterior=stopped), {})).text
    assert "this band is not to be trusted: the fit did not converge" in text
    assert "NOT TO BE TRUSTED" in text
    assert "Verdict: k(s) holds" not in text
    problem = found.posterior.problem
    moved = replace(problem, recordings=tuple(_moved(recording, 1.0) for recording in problem.recordings))
    far = replace(found.posterior, problem=moved)
    text = Links(page(replace(found, posterior=far), {})).text
    assert "the fit misses tag" in text
    assert "The fit misses the tags too far for these tests" in text
    assert "known to±" not in text.replace(" ", "")


def test_what_is_allowed_for_stands_with_its_share() -> None:
    found = made_up.findings(0)
    assert found.posterior is not None
    text = Links(page(found, {})).text
    for share in found.posterior.attributions:
        assert f"{share.name}{share.widening:.2f}{change_words(share.shift)}{share.sds:.1f}" in text
    assert any(share.name == "stretch and shear" for share in found.posterior.attributions)
    [grade] = [value for what, value, _ in cards(found) if what == "verdict"]
    assert grade == found.posterior.grade
    assert any("stretch and shear" in line for line in assumptions(found))
    assert any("neither stretches nor shears" in line for line in assumptions(replace(found, posterior=None)))


def _moved(film: FitData, away: float) -> FitData:
    """Its tags seen `away` [m] from where they were."""
    return replace(film, measured=film.measured + away)


def test_what_is_to_be_typed_stands_as_code_and_cannot_become_markup() -> None:
    assert code_in("use it (`onebend reach`), not `<b>`") == (
        "use it (<code>onebend reach</code>), not <code>&lt;b&gt;</code>"
    )
    assert code_in("one ` alone") == "one ` alone"
    shown = page(made_up.findings(1), {})
    assert "`" not in re.sub(r"<(script|style).*?</\1>", "", shown, flags=re.DOTALL)
