"""The end of a painted body: where it is known, under what lies on the body and over it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from onebend.recording import flanks, outline
from onebend.recording.body_end import body_end, last_point
from onebend.recording.flanks import BodyPlace, Planes, Sight
from onebend.recording.plane import project, to_plane
from onebend.records import END_ID, POINT_ID, Array
from tests.recording.filmed import LENGTH
from tests.recording.test_outline import VIEW, bends, half_width, line, painted, stations_and_hidden

BENDS = bends()


def sights_of(pictures: Sequence[Planes]) -> list[Sight]:
    return [Sight(one, VIEW, np.zeros(2)) for one in pictures]


def ends_in(pictures: Sequence[Planes], bend: Array) -> Array:
    """(N,) px by which the body is found to end beyond s = 1 of the true curves."""
    stations, _, scale = stations_and_hidden()
    curves = [flanks.Curve(*line(b, stations.s)) for b in bend.tolist()]
    found = body_end(
        sights_of(pictures), [last_point(one) for one in curves], LENGTH, 2.0 * float(half_width(np.ones(1))[0])
    )
    return found * scale


def marked(picture: Planes, bend: float, s: float, *, across: float, along: float) -> Planes:
    """The picture with a dark mark on the body about `s`, of these sizes [m]."""
    at, angle = (one[0] for one in line(bend, np.array([s])))
    rows, columns = np.indices(picture.luma.shape)
    xy = to_plane(VIEW, np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float)) - at
    ahead = np.array([np.cos(angle), np.sin(angle)])
    u, v = xy @ ahead, xy @ np.array([-ahead[1], ahead[0]])
    inside = ((np.abs(u) < 0.5 * along) & (np.abs(v) < 0.5 * across)).reshape(picture.luma.shape)
    grey, dark = (np.uint8(one) for one in (128, 30))
    return Planes(np.where(inside, dark, picture.luma), np.where(inside, grey, picture.chroma))


@cache
def pictures_of(ends: float = 1.0) -> tuple[Planes, ...]:
    return tuple(painted(b, ends=ends, seed=i) for i, b in enumerate(BENDS.tolist()))


@pytest.mark.slow
@pytest.mark.parametrize("ends", [pytest.param(0.985, marks=pytest.mark.slow), 0.995, 1.0])
def test_the_end_lies_where_it_was_painted(ends: float) -> None:
    _, _, scale = stations_and_hidden()
    found = ends_in(pictures_of(ends), BENDS) - scale * LENGTH * (ends - 1.0)
    assert np.abs(found - 0.34).max() < 0.2  # `painted` goes on by a third of a pixel, as its samples lie


@pytest.mark.slow
def test_a_dot_at_the_tip_and_a_band_before_it_are_no_end() -> None:
    plain = pictures_of()
    dots = [marked(one, b, 1.0, across=0.003, along=0.003) for one, b in zip(plain, BENDS.tolist(), strict=True)]
    bands = [marked(one, b, 0.97, across=0.02, along=0.002) for one, b in zip(plain, BENDS.tolist(), strict=True)]
    for pictures in (dots, bands):
        assert np.abs(ends_in(pictures, BENDS) - ends_in(plain, BENDS)).max() < 0.3


def test_pictures_whose_end_is_covered_are_left_out() -> None:
    """A tool over it, in two of the pictures and in all."""
    plain = list(pictures_of())
    covered = [marked(one, b, 0.99, across=0.03, along=0.02) for one, b in zip(plain, BENDS.tolist(), strict=True)]
    found = ends_in([*covered[:2], *plain[2:]], BENDS)
    assert np.isnan(found[:2]).all()
    assert np.isfinite(found[2:]).all()
    assert np.isnan(ends_in(covered, BENDS)).all()


def test_the_end_of_the_picture_is_no_end_of_the_body() -> None:
    pictures, bend = pictures_of()[:1], BENDS[:1]
    _, _, scale = stations_and_hidden()
    last = int(project(VIEW, np.array([LENGTH, 0.0]))[0] - 0.01 * LENGTH * scale)
    cut = [Planes(one.luma[:, :last].copy(), one.chroma[:, :, :last].copy()) for one in pictures]
    assert np.isnan(ends_in(cut, bend)).all()


@pytest.mark.slow
def test_the_outline_has_the_end_as_a_point_of_which_what_is_along_it_counts() -> None:
    pictures = pictures_of(0.995)
    stations, hidden, scale = stations_and_hidden()
    sights = sights_of(pictures)
    place = BodyPlace("painted", VIEW, stations, hidden, math.nan)
    found, half = outline.follow(sights, place)
    track = outline.track_of(place, found, half, np.zeros((len(pictures), 2)), {0: sights[0], 4: sights[4]})
    assert track.s[-1] == 1.0
    assert POINT_ID + round(1e3 * track.s[-1]) == END_ID
    true = project(VIEW, np.stack([line(b, np.array([0.995]))[0][0] for b in BENDS.tolist()]))
    assert np.linalg.norm(track.px[:, -1] - true, axis=1).max() < 1.0  # also where it was not looked for
    assert track.sd[0, -1] / np.sqrt(len(pictures)) == pytest.approx(outline.END_SD * scale)
    one = outline.OutlineSearch(found.state[:1], found.away[:1])
    assert outline.track_of(place, one, half, np.zeros((1, 2)), {0: sights[0]}).s[-1] == 1.0
    without = outline.track_of(place, found, half, np.zeros((len(pictures), 2)))
    assert without.s[-1] < 1.0
    assert without.width is not None
    s, width = without.width.T
    assert len(s) > 0.8 * stations.count
    assert s[0] > stations.s[hidden][-1] + outline.BORDER / stations.count  # not beside what hides it
    np.testing.assert_allclose(width, 2.0 * half_width(s), rtol=0.02)


def test_a_longer_body_than_written_is_doubted() -> None:
    pictures = pictures_of()
    stations, hidden, _ = stations_and_hidden()
    sights = sights_of(pictures)
    place = BodyPlace("painted", VIEW, replace(stations, length=0.94 * LENGTH), hidden, math.nan)
    found, half = outline.follow(sights, place)
    track = outline.track_of(place, found, half, np.zeros((len(pictures), 2)), dict(enumerate(sights)))
    (remark,) = [one for one in track.remarks if one.doubt]
    assert "The body ends 9 mm beyond" in remark.text
    assert track.s[-1] < 1.0
