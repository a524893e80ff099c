"""The page speaks of what was done: hung weights are no film, photos no force log."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from onebend.learning.optimizer import FitSettings
from onebend.learning.validation import validate
from onebend.learning.verdict import fitted_rms
from onebend.pipeline import Run, learn
from onebend.records import KnownLoads
from onebend.report.confidence import scale_words
from onebend.report.figures import draw_all
from onebend.report.page import cards, page
from onebend.report.sentences import all_remarks, assumptions, inputs, is_forced, kind_of, learned_from, millimetres
from tests import made_up
from tests.made_up import with_source
from tests.report.page.test_page import Links

pytestmark = pytest.mark.usefixtures("no_other_places")

WEIGHTS = Path(__file__).parents[2] / "examples" / "hung-weights"


@cache
def hung_weights() -> Run:
    return learn(WEIGHTS, fitting=FitSettings(functions=12))


def test_each_kind_is_told_from_the_others() -> None:
    film = made_up.observations()
    tracks = with_source(film, view=None)
    poses = replace(with_source(film, view=None, clean_force=None, clock=None), static=True)
    photos = replace(with_source(film, clean_force=None, clock=None), static=True)
    assert [kind_of(one) for one in (film, tracks, photos, poses)] == ["film", "tracks", "photos", "poses"]
    assert learned_from(film) == f"{int(film.loaded.sum())} loaded frames of a film (90 in all)"
    assert learned_from(tracks).endswith("loaded frames of marker tracks (90 in all)")
    assert learned_from(photos) == "90 photos of the beam under known loads"
    assert learned_from(poses) == "90 static poses under known loads"
    bare = replace(poses, force=np.zeros_like(poses.force))
    assert not is_forced(bare)
    assert learned_from(bare) == "90 static poses under its own weight"
    more = KnownLoads(*(np.ones((90, 1, *shape)) for shape in ((2,), (), (), ())))
    assert is_forced(replace(bare, known_loads=more))
    assert learned_from(with_source(film, clean_force=None)) == "90 frames of a film, under its own weight"


@pytest.mark.slow
def test_the_page_of_hung_weights_speaks_of_no_film_and_of_no_force_log() -> None:
    run = hung_weights()
    text = Links(page(run, {})).text
    for wrong in ("No force was logged", "loaded frames", "the video", "film", "as logged", "force log", "over time",
                  "Force and clock", "sensor", "0.0 s"):  # fmt: skip
        assert wrong not in text.replace("needs a filmed push", ""), wrong
    for right in ("6 static poses under known loads", "Loads and points", "poses in which a tag was found",
                  "load_sd_N", "a balance that reads 1 %"):  # fmt: skip
        assert right in text, right


@pytest.mark.slow
def test_hung_weights_have_one_distance_from_the_fit() -> None:
    """Against the loads as written, with the clamp's turn left in, is no second measure of the same fit."""
    run = hung_weights()
    assert run.posterior is not None
    text = Links(page(run, {})).text
    worst = max(float(np.nanmax(rms)) for rms in fitted_rms(run.posterior))
    worst_card = next(card for card in cards(run) if "worst tag" in card[0])
    assert worst_card[1].startswith(f"{millimetres(worst)}\u00a0mm (tag")
    as_written = validate(run.beam, run.recordings[0]).rms
    said = text.split("Fit to the learned recordings")[1].split("An allowance is an effect of a real beam")[0]
    fitted = {millimetres(value) for value in fitted_rms(run.posterior)[0]}
    other = {millimetres(value) for value in as_written} - fitted
    assert other
    assert all(value in said for value in fitted)
    assert not any(value in said + worst_card[2] for value in other)
    assert "residuals" not in draw_all(run).drawn
    far = replace(run, trainings=tuple(replace(one, rms=one.rms + 1.0) for one in run.trainings))
    assert not any("the simulated beam misses" in remark.text for _, remark in all_remarks(far))
    logged = replace(far, trainings=tuple(replace(one, static=False) for one in far.trainings))
    assert any("the simulated beam misses" in remark.text for _, remark in all_remarks(logged))


@pytest.mark.parametrize("kind", ["film", "tracks", "photos", "poses"])
def test_assumptions_and_inputs_fit_the_kind(kind: str) -> None:
    film = made_up.observations()
    one = film if kind in ("film", "photos") else with_source(film, view=None)
    if kind in ("photos", "poses"):
        one = replace(with_source(one, clean_force=None, clock=None), static=True)
    assert kind_of(one) == kind
    said = " ".join(assumptions(replace(made_up.findings(0), recordings=(one,))))
    assert ("logged force" in said) == (kind in ("film", "tracks"))
    assert ("stood still" in said) == (kind in ("photos", "poses"))
    rows = dict(inputs(one))
    instants = {"film": "frames", "tracks": "frames"}.get(kind, kind)
    assert f"{instants} in which a tag was found" in rows
    assert ("loads" in rows) == (kind in ("photos", "poses"))


def test_the_scale_of_k_is_that_of_what_bends_it() -> None:
    film = made_up.observations()
    assert "assumed to be known to 2 %" in scale_words(0.02, [film], loop=0.005)
    assert "differ by 6 % between a growing and a falling force" in scale_words(0.035, [film], loop=0.03)
    assert "weight" in scale_words(0.0, [with_source(film, clean_force=None)])
    poses = replace(with_source(film, clean_force=None, view=None), static=True)
    assert "known to 5.00 mN each" in scale_words(0.0, [poses])
    assert "assumed to be exact" in scale_words(0.0, [replace(poses, force_sd=np.zeros(2))])
    assert "assumed to be known to 2 %" in scale_words(0.02, [poses, film])
