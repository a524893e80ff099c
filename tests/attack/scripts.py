"""Attack scripts run as processes of their own: they fork and kill, which a test's process must not."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def environment(**more: str) -> dict[str, str]:
    """For a process that imports this repository's onebend and tests."""
    return {**os.environ, "PYTHONPATH": f"{ROOT / 'src'}{os.pathsep}{ROOT}", "OPENBLAS_NUM_THREADS": "1", **more}


def said_by(script: str, *arguments: object) -> Any:
    """What the script printed, as JSON."""
    command = [sys.executable, str(Path(__file__).with_name(script)), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment(), check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def onebend(*arguments: object, **options: Any) -> subprocess.CompletedProcess[bytes]:
    """The command line as a process."""
    more = options.pop("environment", {})
    command = [sys.executable, "-m", "onebend", *map(str, arguments)]
    options = {"capture_output": True, **options}
    return subprocess.run(command, env=environment(**more), check=False, timeout=60, **options)
