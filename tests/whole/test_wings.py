"""The core without its wings: the package with the five folders deleted."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from onebend.cli import all_commands
from onebend.wings import WINGS, commands_of

ROOT = Path(__file__).parents[2]
OF_WINGS = (*WINGS, "whole")  # folders of tests that need a wing


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project without the wings and their tests."""
    copy = tmp_path_factory.mktemp("core")
    for name in (
        "src",
        "tests",
        "benchmarks",
        "examples",
        "docs",
        "pyproject.toml",
        "README.md",
        "SECURITY.md",
        "LICENSE",
    ):
        place = ROOT / name
        (shutil.copytree if place.is_dir() else shutil.copy)(place, copy / name)
    for name in WINGS:
        shutil.rmtree(copy / "src" / "onebend" / name)
    for name in OF_WINGS:
        shutil.rmtree(copy / "tests" / name)
    return copy


def run(core: Path, *words: str) -> str:
    """What `python WORDS` prints in that copy; it must succeed."""
    env = {**os.environ, "PYTHONPATH": str(core / "src"), "COLUMNS": "100"}
    done = subprocess.run([sys.executable, *words], cwd=core, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def test_help_lists_the_commands_that_are_there(core: Path) -> None:
    text = run(core, "-m", "onebend", "--help")
    own = commands_of("cli")
    assert all(f"│ {name} " in text for name in own)
    assert not any(f"│ {name} " in text for name in set(all_commands()) - set(own))


@pytest.mark.slow
def test_every_module_of_the_core_loads(core: Path) -> None:
    code = (
        "import pkgutil, importlib, onebend\n"
        "names = [found.name for found in pkgutil.walk_packages(onebend.__path__, 'onebend.')]\n"
        "[importlib.import_module(name) for name in names if name != 'onebend.__main__']\n"
        "print(len(names))"
    )
    assert int(run(core, "-c", code).split()[-1]) > 80  # Warp, for Newton, says itself on its first import


@pytest.mark.slow
def test_the_tests_of_the_core_pass(core: Path) -> None:
    run(core, "-m", "pytest", "-p", "no:cacheprovider", "--numprocesses=auto", "--dist=loadfile")


@pytest.mark.slow
def test_the_demo_works(core: Path) -> None:
    learn = ("learn", "examples/linear-beam/train", "--validate", "examples/linear-beam/fast", "--output", "out")
    assert "k(s)" in run(core, "-m", "onebend", *learn)
