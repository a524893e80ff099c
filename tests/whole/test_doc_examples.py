"""Every example in Python of the README and the documentation runs as it is printed."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import onebend
from onebend.beam.model import Beam
from onebend.beam.stiffness import UncertainStiffness, Uniform
from onebend.lab.bench import PushProfile
from onebend.lab.virtual import VirtualBench, observe_virtual, virtual_recording
from onebend.records import Observations
from onebend.report.sentences import words
from onebend.results.model import save_model
from tests.learning.swinging import HEAVY, released

ROOT = Path(__file__).parents[2]
# Those that need more than a page can give are run where their subject is tested, or need a slow film.
ELSEWHERE = {
    "README.md": 1,  # tests/test_end_to_end.py
    "lab.md": 4,  # tests/lab/fabrication/test_bench_page.py, test_page.py; tests/lab/filming/test_film.py for the film
    "live.md": 2,  # tests/live/test_live_page.py, tests/live/learner/test_online_learner.py
    "record.md": 1,  # tests/live/test_record_page.py
}


def blocks(page: Path) -> list[str]:
    """The examples of a page, in order."""
    return re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def test_no_page_has_an_example_that_nothing_runs() -> None:
    """A page with a new example is added here, or to ELSEWHERE."""
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    counts = {page.name: len(blocks(page)) for page in pages if blocks(page)}
    assert counts == {**ELSEWHERE, **Counter(page for page, _ in GIVEN)}


@pytest.fixture(scope="module")
def pushes() -> list[Observations]:
    """Three pushes of one beam with few frames and little noise."""
    bench = VirtualBench(BEAM, PushProfile(0.3), fps=6.0)
    return [observe_virtual(virtual_recording(bench, seed=seed)) for seed in range(3)]


BEAM = Beam(0.15, Uniform(0.02))
KNOTS = np.array([0.0] * 4 + [1.0] * 4)


def banded(k: Sequence[float]) -> UncertainStiffness:
    """k(s) of four heights with a narrow band."""
    return UncertainStiffness(KNOTS, np.log(np.asarray(k)), 1e-4 * np.eye(4))


def control(_there: dict[str, Any], _: Any) -> None:
    band = banded([0.02] * 4)
    save_model(
        Path("beam-results/model.json"), replace(BEAM, stiffness=band.profile), written_by="a test", uncertain=band
    )


def control_shape(there: dict[str, Any], _: Any) -> None:
    s = np.linspace(0.2, 1.0, 9)
    shape = BEAM.equilibrium((-0.05, 0.12))
    there |= {"beam": BEAM, "s": s, "xy": shape.xy(s)}


def control_loop(there: dict[str, Any], _: Any) -> None:
    """Three frames; the third shows nothing."""
    frames = [None, (0.13, 0.05), (float("nan"), float("nan"))]

    class Robot:
        def __init__(self) -> None:
            self.pushed: list[Any] = []

        def push(self, force: Any) -> None:
            self.pushed.append(force)

    save_model(Path("results/model.json"), BEAM, written_by="a test")
    there |= {"running": lambda: bool(frames), "camera": lambda: frames.pop(0), "robot": Robot()}


def plan(there: dict[str, Any], pushes: list[Observations]) -> None:
    there |= {"onebend": onebend, "observations": pushes[0], "start": BEAM.stiffness}


def sklearn(there: dict[str, Any], pushes: list[Observations]) -> None:
    pytest.importorskip("sklearn")
    given = dict(zip(("push-1", "push-2", "push-3"), pushes, strict=True))

    class Onebend:
        observe = staticmethod(given.__getitem__)

    there |= {"onebend": Onebend}


def damping(there: dict[str, Any], _: Any) -> None:
    band = banded([0.03, 0.015, 0.015, 0.03])
    there |= {"onebend": onebend, "beam": HEAVY, "observations": released(), "uncertain": band}


def nothing(there: dict[str, Any], _: Any) -> None:
    """The example stands alone."""


# The examples of the pages, numbered from 0, with what each is given.
GIVEN = {
    ("control.md", 0): control,
    ("control.md", 1): control_shape,
    ("control.md", 2): control_loop,
    ("damping.md", 0): damping,
    ("export.md", 0): nothing,
    ("method.md", 0): nothing,
    ("plan.md", 0): plan,
    ("plan.md", 1): nothing,
    ("real-lab.md", 0): plan,
    ("sklearn.md", 0): sklearn,
}
SLOW = (("plan.md", 0), ("real-lab.md", 0), ("sklearn.md", 0))  # which learn from pushes


@pytest.mark.parametrize(
    ("page", "number"), [pytest.param(*one, marks=pytest.mark.slow) if one in SLOW else one for one in GIVEN]
)
def test_the_example_runs(
    page: str, number: int, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ("results", "beam-results"):
        (tmp_path / folder).mkdir()
    there: dict[str, Any] = {}
    GIVEN[page, number](there, request.getfixturevalue("pushes") if (page, number) in SLOW else [])
    exec(blocks(ROOT / "docs" / page)[number], there)
    assert_sound(page, number, there)


def assert_sound(page: str, number: int, there: dict[str, Any]) -> None:
    """That what the example ends with is no accident."""
    if page == "control.md":
        assert_reached(number, there)
    elif page == "damping.md":
        assert there["fit"].damping.loss_time > 0.0
    elif page == "method.md":
        assert there["hangs"][0] > there["laden"][0] > 0.0
    elif page == "export.md":
        assert "<mujoco" in Path("beam.xml").read_text(encoding="utf-8")
    elif page == "real-lab.md":
        assert there["found"].grade != "not to be trusted"
        assert "stiff tags" not in {share.name for share in there["found"].attributions}
    elif page == "sklearn.md":
        assert np.all(there["k"] > there["sd"])
        assert np.all(there["error_m"] < 0.05)
    else:
        found = there["found"]
        said = [one.text for one in found.advice] if number else [words(one.notice) for one in found.proposals]
        assert all(said)
        assert said


def assert_reached(number: int, there: dict[str, Any]) -> None:
    """That a goal, a shape, a loop came to where they are to be."""
    if number == 0:
        assert there["found"].converged
    elif number == 1:
        assert there["found"].rms < 0.002
    else:
        assert len(there["robot"].pushed) == 3
        assert np.isfinite(there["robot"].pushed).all()
