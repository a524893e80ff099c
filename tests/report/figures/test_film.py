"""The film's frames on the page: small, in their own pixels, and never a reason to fail."""

from __future__ import annotations

import base64
import html as markup
import io
import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from onebend.beam.model import Beam
from onebend.beam.stiffness import UncertainStiffness
from onebend.learning.outcome import Explained
from onebend.learning.verdict import explained
from onebend.recording.entries import VideoEntry
from onebend.recording.plane import project
from onebend.recording.video import KeptFrames, pictures_at
from onebend.records import Observations
from onebend.report import figures as drawing, pictures as film
from onebend.report.page import page
from onebend.report.pictures import MOST_FRAMES, WIDEST, film_strip, shape_band, spread_frames
from tests import made_up
from tests.made_up import with_source
from tests.recording.test_kept_frames import pass_by
from tests.recording.test_video import write_video
from tests.report.page.browser import after_script


@cache
def known() -> tuple[Explained, Beam, UncertainStiffness]:
    """What is drawn: a fit, its beam and its band."""
    found = made_up.posterior()
    return explained(found)[0], found.beam, found.stiffness


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Observations:
    """Noise, as no JPEG packs well, and a bright square where the last tag was seen: where the fit has the mean of some
    frames, it stands at that mean in the frame that is shown."""
    seen, means = made_up.observations(), made_up.posterior().recordings[0].observations
    tip = seen.xy[:, -1].copy()
    tip[means.frame] = means.xy[:, -1]
    assert seen.source.view is not None
    rng = np.random.default_rng(0)
    lumas = [rng.integers(0, 120, (480, 640), dtype=np.uint8) for _ in seen.frame]
    for luma, place in zip(lumas, project(seen.source.view, tip), strict=True):
        if np.isfinite(place).all():
            x, y = place.round().astype(int)
            luma[y - 9 : y + 10, x - 9 : x + 10] = 255
    path = tmp_path_factory.mktemp("film") / "film.mkv"
    return with_source(seen, video=write_video(path, lumas, range(0, 40 * len(lumas), 40)).file)


def test_frames_are_read_in_one_pass(filmed: Observations) -> None:
    assert filmed.source.video is not None
    entry = VideoEntry(file=filmed.source.video)
    found = dict(pictures_at(entry, [7, 2, 5000], colour=True))
    assert list(found) == [2, 7]
    [(_, alone)] = pictures_at(entry, [7], colour=True)
    np.testing.assert_array_equal(found[7], alone)


def jpeg_of(frame: dict[str, Any]) -> bytes:
    return base64.b64decode(frame["picture"].removeprefix("data:image/jpeg;base64,"))


@pytest.mark.slow
def test_frames_that_were_kept_make_the_same_strip(filmed: Observations) -> None:
    assert filmed.source.video is not None
    kept, entry = KeptFrames(), VideoEntry(file=filmed.source.video)
    pass_by(kept, entry)
    sought, passed = (film_strip(filmed, *known(), one) for one in (None, kept))
    assert sought is not None
    assert passed is not None
    assert [one["picture"] for one in passed["frames"]] == [one["picture"] for one in sought["frames"]]


def test_the_frames_shown_are_spread_and_likely_to_be_kept() -> None:
    frame = np.arange(60, 501)
    places = spread_frames(frame)
    assert len(places) == MOST_FRAMES
    assert np.diff(places, prepend=0, append=len(frame) - 1).max() <= 2 * np.ceil(len(frame) / MOST_FRAMES)
    assert np.all(np.diff(places) > 0)
    assert np.all(frame[places] % 8 == 0)
    assert spread_frames(frame[:5]).tolist() == [0, 1, 2, 3, 4]


@pytest.mark.slow
def test_what_is_drawn_stands_where_the_small_picture_shows_it(filmed: Observations) -> None:
    strip = film_strip(filmed, *known())
    assert strip is not None
    assert strip["width"] <= WIDEST
    assert 16 <= len(strip["frames"]) <= MOST_FRAMES
    count = 0
    for one in strip["frames"]:
        image = Image.open(io.BytesIO(jpeg_of(one)))
        assert image.size == (strip["width"], strip["height"])
        np.testing.assert_allclose(one["beam_px"][-1], one["arrow_px"][1], atol=1e-9)  # pushed at the tip
        bright = np.argwhere(np.asarray(image.convert("L")) > 200)[:, ::-1]
        if np.linalg.norm(np.subtract(one["beam_px"][-1], one["tags_px"][-1])) < 3.0:  # the tip's tag is seen
            count += 1
            np.testing.assert_allclose(np.median(bright, axis=0), one["tags_px"][-1], atol=1.5)
    assert count > len(strip["frames"]) // 2
    sizes = [np.linalg.norm(one["force_N"]) for one in strip["frames"]]
    lengths = [np.linalg.norm(np.subtract(*one["arrow_px"])) for one in strip["frames"]]
    assert np.argmax(sizes) == np.argmax(lengths)


@pytest.mark.slow
def test_the_frames_stay_below_their_limit(filmed: Observations, monkeypatch: pytest.MonkeyPatch) -> None:
    fine = film_strip(filmed, *known())
    assert fine is not None
    size = sum(len(jpeg_of(one)) for one in fine["frames"])
    assert size <= film.LARGEST
    monkeypatch.setattr(film, "LARGEST", size // 2)
    small = film_strip(filmed, *known())
    assert small is not None
    assert sum(len(jpeg_of(one)) for one in small["frames"]) <= size // 2


def test_the_band_of_the_shape_is_what_k_does_to_it(filmed: Observations) -> None:
    """All of k 5 % stiffer or softer (sd): the band's edge is where a beam softer by 1.96 of that stands."""
    fitted, beam, uncertain = known()
    chosen = np.array([len(fitted.comparison.frame) // 2])
    band = shape_band(beam, uncertain, filmed, fitted, chosen)
    assert band.shape == (1, 2, 31, 2)
    assert np.linalg.norm(band[0, 0] - band[0, 1], axis=-1)[0] == pytest.approx(0.0, abs=1e-9)  # at the clamp
    common = replace(uncertain, covariance=0.0 * uncertain.covariance, gain_sd=0.05)
    wide = shape_band(beam, common, filmed, fitted, chosen)
    force, at = fitted.logged[chosen][0], fitted.comparison.push_s[chosen][0]
    soft, stiff = (
        replace(beam, stiffness=replace(common, mean=common.mean + shift).profile).equilibrium(force, at).xy(1.0)
        for shift in (-1.96 * 0.05, 1.96 * 0.05)
    )
    assert np.linalg.norm(wide[0, 0, -1] - wide[0, 1, -1]) == pytest.approx(np.linalg.norm(soft - stiff), rel=0.45)


def test_without_film_or_camera_there_are_no_frames(filmed: Observations, tmp_path: Path) -> None:
    assert film_strip(with_source(filmed, video=tmp_path / "gone.mp4"), *known()) is None
    assert film_strip(with_source(filmed, view=None), *known()) is None


@pytest.mark.slow
def test_frames_that_cannot_be_made_cost_only_themselves(filmed: Observations, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ValueError("no memory")

    found = replace(made_up.findings(0), recordings=(filmed,), learned=None)
    monkeypatch.setattr(drawing, "film_strip", fails)
    pictures = drawing.draw_all(found)
    assert pictures.film is None
    assert pictures.failed == {"film": "ValueError: no memory"}
    assert "fit" in pictures.drawn


@pytest.mark.slow
def test_the_slider_goes_through_the_film(filmed: Observations, tmp_path: Path) -> None:
    strip = film_strip(filmed, *known())
    assert strip is not None
    html = page(made_up.findings(0), {"fit": b"png"}, film=strip)
    assert len(html) < 5_000_000
    title = after_script(
        html,
        """
        const film = document.getElementById("film"), slider = film.querySelector("input"), said = [];
        const image = film.querySelector("image");
        for (const value of [slider.value, 0, slider.max]) {
          slider.value = value; slider.dispatchEvent(new Event("input"));
          said.push([Number(value), film.querySelector(".readout").textContent, image.getAttribute("href").length]);
        }
        said.push(film.hidden, document.querySelector("[data-instead=film]").hidden);
        document.title = JSON.stringify(said);
        """,
        tmp_path,
    )
    hardest, first, last, hidden, still_hidden = json.loads(markup.unescape(title))
    sizes = [float(np.linalg.norm(one["force_N"])) for one in strip["frames"]]
    assert hardest[0] == int(np.argmax(sizes))
    assert first[1].startswith(f"frame {strip['frames'][0]['frame']} · 0.00 s")
    assert last[0] == len(strip["frames"]) - 1
    assert last[1].startswith(f"frame {strip['frames'][-1]['frame']} · ")
    assert first[2] > 1000
    assert not hidden
    assert still_hidden
