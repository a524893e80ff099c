"""What is said of a picture before the film begins."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.live.guidance import TagView, Widening, setup_advice, tag_views
from onebend.recording.tag_finder import Finder
from onebend.records import Array
from tests.recording.filmed import HEIGHT, WIDTH, corners_of, picture, poses, recording, view

REST = poses(1)[0]
TAGS = recording().tags


def shown(levels: tuple[float, float] = (0.0, 1.0), hidden: tuple[int, ...] = ()) -> tuple[np.ndarray, list[TagView]]:
    """The beam at rest, its grey levels stretched, without some of its tags; and what a finder sees of them."""
    kept = [i for i in range(4) if i not in hidden]
    clean = picture(REST[kept], kept, view())
    frame = np.clip(255.0 * (levels[0] + (levels[1] - levels[0]) * clean / 255.0), 0, 255).astype(np.uint8)
    found = {tag.tag_id: tag.corners for tag in Finder("tag36h11").look(frame, range(4))}
    return frame, list(tag_views(TAGS, np.array([found.get(i, np.full((4, 2), np.nan)) for i in range(4)])))


def moved(views: list[TagView], change: Array, scale: float = 1.0) -> list[TagView]:
    middle = np.array([WIDTH, HEIGHT]) / 2
    return [TagView(tag.id, tag.s, (tag.corners - middle) * scale + middle + change, tag.on_base) for tag in views]


def test_a_good_picture_needs_nothing() -> None:
    assert setup_advice(*shown()) == []


def test_small_tags_are_named_with_their_size() -> None:
    frame, views = shown()
    [said] = [one for one in setup_advice(frame, moved(views, np.zeros(2), 0.55)) if "px" in one]
    smallest = min(0.55 * tag.side_px for tag in views)
    assert f"is {smallest:.0f} px" in said
    assert said.endswith("come nearer, until each is 20 px or more")


def test_large_tags_leave_no_room() -> None:
    frame, views = shown()
    assert any("go farther" in one for one in setup_advice(frame, moved(views, np.zeros(2), 5.0)))


@pytest.mark.parametrize(
    ("levels", "says"),
    [((0.6, 1.8), "burnt out: expose for less"), ((0.3, 0.5), "grey on grey")],
)
def test_light_is_judged_on_the_tags(levels: tuple[float, float], says: str) -> None:
    frame, _ = shown(levels)
    _, views = shown()
    assert any(says in one for one in setup_advice(frame, views))


@pytest.mark.parametrize(
    ("level", "says"),
    [(8, "dark"), (250, "burnt out"), (120, "bring tags 0, 1, 2, 3 into it")],
)
def test_a_picture_without_tags_says_why(level: int, says: str) -> None:
    frame = np.full((HEIGHT, WIDTH), level, np.uint8)
    [said] = setup_advice(frame, tag_views(TAGS, np.full((4, 4, 2), np.nan)))
    assert says in said


def test_other_tags_than_those_written_are_named() -> None:
    frame = np.full((HEIGHT, WIDTH), 120, np.uint8)
    [said] = setup_advice(frame, tag_views(TAGS, np.full((4, 4, 2), np.nan)), [7, 5, 7])
    assert said == "the tags in the picture are 5, 7, and recording.toml names 0, 1, 2, 3: correct the ids"


def test_a_hidden_tag_is_named() -> None:
    said = setup_advice(*shown(hidden=(2,)))
    assert said == ["tag 2 is not seen: nothing may hide it, and no light may glare on it"]


def test_a_tag_at_the_edge_is_named() -> None:
    frame, views = shown()
    left = min(tag.corners[:, 0].min() for tag in views)
    assert any(
        "at the picture's edge" in one for one in setup_advice(frame, moved(views, np.array([-left - 1.0, 0.0])))
    )


def test_the_views_are_where_the_tags_are() -> None:
    _, views = shown()
    assert [tag.on_base for tag in views] == [True, False, False, False]
    true = corners_of(REST, view())
    assert np.abs(np.array([tag.corners for tag in views]) - true).max() < 0.5


SIZES = {"tags": 1.0, "force": 0.01, "drift": 0.002, "load": 0.5}


def test_a_band_that_widens_says_why() -> None:
    before = Widening(0.20, SIZES)
    assert before.why(float("nan"), {}) == ""
    assert before.why(0.22, {**SIZES, "tags": 3.0}) == ""  # hardly wider
    said = before.why(0.30, {**SIZES, "tags": 4.0, "drift": 0.004, "load": 0.9})
    assert said.startswith("wider than the ± 20 % that it was: the tags miss the fitted shape by 4")
    assert "drifts 3 times as much" in before.why(0.30, {**SIZES, "drift": 0.006})
    assert "all frames were read again" in before.why(0.30, SIZES)
    assert Widening().why(0.30, SIZES) == ""
