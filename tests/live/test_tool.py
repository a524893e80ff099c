"""After a stream is over, the tool is looked for in the pictures that were kept of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from onebend.live.live import Live, LiveSettings
from onebend.live.review import Seen, observed_in
from onebend.recording.entries import PushEntry
from onebend.recording.plane import to_plane
from onebend.recording.video import Picture
from onebend.records import Array
from tests.live.disturbed import play
from tests.live.followed import follow
from tests.live.streamed import BEAM, DURATION, OFFSET, REST, described, force_at, frames, log
from tests.recording.filmed import GROUND, HEIGHT, WIDTH, view

HALF, WIDTH_OF_TOOL = 0.006, 0.006  # m, of the beam and of the tool
SHADE_OF_BEAM, SHADE_OF_TOOL = 180, 60


@cache
def plane() -> Array:
    """(H, W, 2) m, where the picture's pixels look."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return to_plane(view(), np.stack([columns, rows], axis=-1).astype(float))


def with_tool(picture: Picture, time: float) -> Picture:
    """The picture with the beam drawn in it, and the tool at its tip while it pushes."""
    shape, s = BEAM.equilibrium(force_at(np.array([time]))), np.linspace(0.0, 1.0, 41)
    axis, x, y = shape.xy(s)[0], plane()[..., 0], plane()[..., 1]
    ground = np.abs(picture.astype(int) - GROUND) < 12
    out = picture.copy()
    near = np.abs(y - np.interp(x, axis[:, 0], axis[:, 1])) < HALF
    out[ground & near & (x > 0.0) & (x < axis[-1, 0])] = SHADE_OF_BEAM
    if REST - 0.05 < time < DURATION - REST + 0.05:
        below = y - axis[-1, 1] < -HALF
        out[ground & below & (np.abs(x - axis[-1, 0]) < 0.5 * WIDTH_OF_TOOL)] = SHADE_OF_TOOL
    return out


@cache
def streamed() -> Seen:
    film = [replace(one, luma=with_tool(one.luma, one.time)) for one in frames()]
    live = Live(described(OFFSET, 0.0), settings=LiveSettings(first_review=np.inf), beside=False)
    follow(live, play(film, log(), OFFSET))
    return live._seen()


@pytest.mark.slow
def test_the_place_of_the_push_is_seen_as_in_a_film() -> None:
    assert observed_in(streamed()).source.place_seen
    assert not observed_in(replace(streamed(), pictures={})).source.place_seen


def test_another_place_is_warned_of() -> None:
    seen = streamed()
    elsewhere = replace(seen, recording=replace(seen.recording, push=PushEntry(at=0.5)))
    source = observed_in(elsewhere).source
    (said,) = [remark for remark in source.remarks if remark.about == "tool place"]
    assert "recording.toml says at_s = 0.5" in said.text
    assert not source.place_seen
