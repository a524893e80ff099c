"""The core does without the optional packages, and names the line that installs a missing one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from onebend.errors import MissingPackageError, OnebendError
from onebend.extras import package, require
from onebend.results.model import save_model
from tests import made_up

ROOT = Path(__file__).parents[2]
OF_EXTRAS = ("cv2", "rosbags", "starlette")
VIDEO = str(ROOT / "examples/linear-beam/train/video.mp4")


def without_extras(*lines: list[str]) -> subprocess.CompletedProcess[str]:
    """`onebend` with each line of arguments, up to one that fails, in a Python that has none of the optional
    packages."""
    call = f"""import sys
sys.modules.update(dict.fromkeys({OF_EXTRAS!r}))
from onebend.cli import main
for line in {lines!r}:
    sys.argv = ["onebend", *line]
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
"""
    return subprocess.run([sys.executable, "-c", call], capture_output=True, text=True, check=False)


def test_a_missing_package_is_an_error_of_onebend_and_an_import_error() -> None:
    with pytest.raises(MissingPackageError, match=r"no_such_package.*pip install 'onebend\[calibrate\]'") as caught:
        package("no_such_package", "calibrate")
    assert isinstance(caught.value, OnebendError)
    assert isinstance(caught.value, ImportError)
    assert caught.value.name == "no_such_package"
    with pytest.raises(MissingPackageError, match=r"no_such, nor_this.*onebend\[studio\]"):
        require(("sys", "no_such", "nor_this"), "studio")


@pytest.mark.parametrize(
    ("extra", "arguments"),
    [
        ("ros", ("topics", "BAG")),
        pytest.param(
            "calibrate",
            ("calibrate", VIDEO, "--board", "chessboard", "9x6", "--square-mm", "20"),
            marks=pytest.mark.slow,
        ),
        pytest.param("studio", ("studio", "."), marks=pytest.mark.slow),
    ],
)
def test_a_command_names_the_extra_that_it_lacks(extra: str, arguments: tuple[str, ...], tmp_path: Path) -> None:
    bag = tmp_path / "log.mcap"
    bag.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    places = {"OUT": str(tmp_path / "out"), "BAG": str(bag)}
    done = without_extras([places.get(word, word) for word in arguments])
    assert done.returncode == 2
    assert f"pip install 'onebend[{extra}]'" in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_what_needs_no_extra_works_without_them(tmp_path: Path) -> None:
    fit = made_up.posterior()
    model, goals = tmp_path / "model.json", tmp_path / "goals.csv"
    save_model(model, fit.beam, written_by="a test", uncertain=fit.stiffness)
    places = [fit.beam.equilibrium((0.0, newtons)).xy(1.0) for newtons in (0.2, 0.3)]
    goals.write_text("time_s,x_m,y_m\n" + "".join(f"{time},{x},{y}\n" for time, (x, y) in enumerate(places)))
    done = without_extras(
        ["design", "linear"],
        ["tags", str(ROOT / "examples/linear-beam/train"), "-o", str(tmp_path / "tags.svg")],
        ["path", str(model), "--goals", str(goals), "--rate-Hz", "20", "-o", str(tmp_path / "path")],
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "tags.svg").is_file()
    assert (tmp_path / "path" / "path.csv").is_file()
