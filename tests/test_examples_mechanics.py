"""docs/method.md says what the code does: its snippets run, its figures are drawn and its numbers come out."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from examples import mechanics

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")


def test_snippets_print_what_the_page_shows() -> None:
    blocks = re.findall(r"^```pycon\n(.*?)^```$", PAGE, flags=re.DOTALL | re.MULTILINE)
    snippets = doctest.DocTestParser().get_doctest("\n".join(blocks), {}, "method.md", None, 0)
    said: list[str] = []
    runner = doctest.DocTestRunner(verbose=False)
    runner.run(snippets, out=said.append)
    assert len(snippets.examples) > 20
    assert runner.failures == 0, "".join(said)


@pytest.mark.slow
def test_every_figure_is_drawn_and_shown(tmp_path: Path) -> None:
    written = mechanics.main(tmp_path)
    assert set(re.findall(r"images/(mechanics-[a-z-]+\.png)", PAGE)) == {path.name for path in written}
    for path in written:
        assert path.stat().st_size < 120_000
        with Image.open(path) as drawn, Image.open(ROOT / "docs" / "images" / path.name) as kept:
            assert drawn.size == kept.size


def test_table_of_limits_stands_on_the_page() -> None:
    assert mechanics.limits() in PAGE
    assert "0.96 for a width of half the thickness, 0.27 for a quarter, 0.045 for a tenth" in PAGE
    ratios = [mechanics.leaves_the_plane(b) for b in (0.5, 0.25, 0.1)]
    np.testing.assert_allclose(ratios, (0.96, 0.27, 0.045), rtol=0.02)


@pytest.mark.parametrize("degrees", [45.0, 90.0, 135.0, 175.0])
def test_shapes_are_the_elastica_along_the_whole_beam(degrees: float) -> None:
    assert np.max(mechanics.elastica_error(np.geomspace(0.1, 10.0, 7), np.deg2rad(degrees))) < 2e-11


def test_error_is_spectral_unless_a_jump_lies_inside_a_panel() -> None:
    hidden = mechanics.Hidden(mechanics.STEP.edges, mechanics.STEP.values)
    _, smooth = mechanics.convergence(mechanics.Bump(), np.array([8, 16, 26]), mechanics.Bump())
    _, known = mechanics.convergence(mechanics.STEP, np.array([4, 8]), mechanics.STEP)
    _, unknown = mechanics.convergence(hidden, np.array([16, 24, 32]), mechanics.STEP)
    assert smooth[1] < 1e-4 * smooth[0]
    assert smooth[2] < 1e-14
    assert known[1] < 1e-5 * known[0]
    assert np.min(unknown) > 1e-4


def test_straight_column_loses_stability_at_eulers_load() -> None:
    column = mechanics.compressed(np.array([1.6]), 0.0)
    assert 1.6 * column.buckled_at[0] == pytest.approx(1.0, abs=1e-6)
