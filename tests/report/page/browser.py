"""Pages in a real browser, and scripts in Node; tests are skipped where there is none."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def after_script(html: str, script: str, folder: Path, width: int = 1280) -> str:
    """The text of `document.title` after the page was loaded, and then `script` run in it.

    The page allows no script but its own; that is taken off here, for `script` alone.
    """
    open_page = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", html)
    return title_of(open_page.replace("</body>", f"<script>{script}</script></body>"), folder, width)


def title_of(html: str, folder: Path, width: int = 1280) -> str:
    """The text of `document.title` after the page was loaded."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"none of {', '.join(BROWSERS)} is installed: the page's script is not run")
    page = folder / "page.html"
    page.write_text(html, encoding="utf-8")
    flags = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}",
             f"--window-size={width},900", "--virtual-time-budget=3000", "--dump-dom"]  # fmt: skip
    done = subprocess.run([browser, *flags, page.as_uri()], capture_output=True, timeout=120, check=True)
    found = re.search(r"<title>(.*?)</title>", done.stdout.decode(), re.DOTALL)
    assert found is not None, done.stderr.decode()[-2000:]
    return found[1]


def node_output(script: str, folder: Path) -> str:
    """What Node prints."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("Node is not installed: the page's solver is not run")
    file = folder / "script.js"
    file.write_text(script, encoding="utf-8")
    return subprocess.run([node, str(file)], capture_output=True, text=True, timeout=60, check=True).stdout
