"""What a fresh machine installs: the locks whatever is newer on the index, and the built package elsewhere."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OLDEST_PIP = "22.3"  # what Python 3.11.0 brings
NEWER = "99999.0"
PINNED = re.compile(r"^([A-Za-z0-9._-]+)==[^ ;\\]+", re.MULTILINE)
RECORDING = ROOT / "examples" / "linear-beam" / "train"
pytestmark = pytest.mark.slow


def done(command: Sequence[str | Path], folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command; no setting of this process's Python reaches it."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
    return subprocess.run(command, cwd=folder, env=inherited | environment, capture_output=True, text=True, check=False)


def environment_in(folder: Path) -> Path:
    """A new virtual environment; its Python."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    return folder / "bin" / "python"


def stub_wheel(folder: Path, name: str) -> None:
    """An empty package of a version that is newer than any."""
    plain = re.sub(r"[-_.]+", "_", name).lower()
    inside = f"{plain}-{NEWER}.dist-info"
    with zipfile.ZipFile(folder / f"{plain}-{NEWER}-py3-none-any.whl", "w") as wheel:
        wheel.writestr(f"{inside}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: {NEWER}\n")
        wheel.writestr(
            f"{inside}/WHEEL", "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        wheel.writestr(f"{inside}/RECORD", "")


def test_both_locks_install_though_everything_has_a_newer_version(tmp_path: Path) -> None:
    clone, stubs = tmp_path / "clone", tmp_path / "stubs"
    clone.mkdir()
    stubs.mkdir()
    for name in ("Makefile", "pyproject.toml", "README.md", "LICENSE", "requirements.lock", "requirements-dev.lock"):
        shutil.copy(ROOT / name, clone)
    shutil.copytree(ROOT / "src", clone / "src", ignore=shutil.ignore_patterns("__pycache__"))
    locked = {name for lock in clone.glob("*.lock") for name in PINNED.findall(lock.read_text())}
    assert {"numpy", "coverage"} <= locked
    for name in sorted(locked):
        stub_wheel(stubs, name)
    python = environment_in(clone / ".venv")
    assert done([python, "-m", "pip", "install", "--quiet", f"pip=={OLDEST_PIP}"], clone).returncode == 0
    newer = {"PIP_FIND_LINKS": str(stubs)}
    resolved: list[str | Path] = [
        python,
        "-m",
        "pip",
        "install",
        "--dry-run",
        "--require-hashes",
        "-r",
        "requirements-dev.lock",
    ]
    assert "coverage" in done(resolved, clone, **newer).stderr  # the stubs do mislead an installation that resolves

    made = done(["make", ".venv/.ready-dev"], clone, **newer)
    assert made.returncode == 0, made.stderr
    assert NEWER not in done([python, "-m", "pip", "freeze"], clone).stdout
    assert "numpy" in done([python, "-m", "pip", "freeze"], clone).stdout


def learn_elsewhere(python: Path, folder: Path) -> None:
    """Learn a copied recording with the installed program, away from the sources."""
    shutil.copytree(RECORDING, folder / "push")
    program = python.with_name("onebend")
    learned = done([program, "learn", "push", "-o", "out", "--quiet"], folder, ONEBEND_CACHE="off")
    assert learned.returncode == 0, learned.stderr
    assert (folder / "out" / "model.json").is_file()
    assert (folder / "out" / "report.html").is_file()


@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_the_built_package_learns_in_an_empty_environment_elsewhere(kind: str, tmp_path: Path) -> None:
    files = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    listed = subprocess.run(files, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    source = tmp_path / "source"
    for name in listed.split("\0"):
        if name.startswith(("src/", "tools/")) or (name and "/" not in name):
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, source / name)
    built = done([sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", tmp_path / "dist"], source)
    assert built.returncode == 0, built.stderr
    [package] = (tmp_path / "dist").iterdir()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    python = environment_in(elsewhere / "env")
    install: list[str | Path] = [python, "-m", "pip", "install", "--quiet", "--no-deps"]
    locked = done([*install, "--require-hashes", "-r", ROOT / "requirements.lock"], elsewhere)
    assert locked.returncode == 0, locked.stderr
    installed = done([*install, "--no-build-isolation", package], elsewhere)
    assert installed.returncode == 0, installed.stderr
    assert done([python, "-m", "pip", "check"], elsewhere).returncode == 0

    learn_elsewhere(python, elsewhere)
    place = done([python, "-c", "import onebend.studio; print(onebend.studio.__path__[0])"], elsewhere).stdout.strip()
    assert Path(place).is_relative_to(elsewhere)
    page = {file.name for file in (Path(place) / "page").iterdir()}
    assert page == {file.name for file in (ROOT / "src/onebend/studio/page").iterdir() if file.name != "__pycache__"}
    assert "index.html" in page
