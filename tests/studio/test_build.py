"""The page that is served was built from the sources that stand beside it."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from onebend.studio.server import PAGE
from tests.report.page.browser import node_output

SOURCES = Path(__file__).parents[2] / "web" / "src"


def test_the_page_is_of_these_sources() -> None:
    if not SOURCES.is_dir():
        pytest.skip("the sources of the page are not here: an installed package")
    written = json.loads((PAGE / "sources.json").read_text())
    now = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(SOURCES.iterdir())}
    assert written == now, "build the page again: cd web && npm ci && npm run build"


def test_every_source_has_its_built_file_and_no_other_is_there() -> None:
    written = json.loads((PAGE / "sources.json").read_text())
    built = {name.replace(".ts", ".js") for name in written}
    assert {path.name for path in PAGE.iterdir()} == built | {"sources.json"}


def test_the_server_is_there_before_what_a_room_needs_is_loaded() -> None:
    """The first picture waits for no room but its own."""
    call = "import sys, onebend.studio.server; print(*sys.modules)"
    loaded = set(
        subprocess.run([sys.executable, "-c", call], capture_output=True, text=True, check=True).stdout.split()
    )
    rooms = {"bending", "driving", "learned", "learner", "looping", "recorder", "recordings", "requests", "worker"}
    assert not loaded & {f"onebend.studio.{name}" for name in rooms}
    assert not loaded & {"scipy", "av", "PIL", "matplotlib", "pyapriltags", "onebend.recording", "onebend.control"}
    assert imported("main") == {"bend", "dom", "net", "place"}


def imported(name: str) -> set[str]:
    """The files that a built one loads at once."""
    return set(re.findall(r'from "\./(\w+)\.js"', (PAGE / f"{name}.js").read_text(encoding="utf-8")))


def test_the_page_names_all_files_of_its_first_picture() -> None:
    """So that none of them waits for another one that loads it."""
    found, new = set[str](), imported("main")
    while new:
        found |= new
        new = set().union(*(imported(one) for one in new)) - found
    named = re.findall(r'rel="modulepreload" href="(\w+)\.js"', (PAGE / "index.html").read_text(encoding="utf-8"))
    assert sorted(named) == sorted(found)


@pytest.mark.parametrize(("room", "words"), [(320, "WIDE"), (1000, "WIDE"), (150, "HIGH")])
def test_every_axis_has_ticks_and_room_for_their_words(tmp_path: Path, room: int, words: str) -> None:
    """Of a plane in a window of 390 px, of one in a wide window, of a chart's height."""
    spans = [1.0, 1.7, 2.6, 4.0, 6.3, 8.1]
    script = (
        f"import * as draw from {json.dumps((PAGE / 'draw.js').as_uri())};"
        f"const straight = (span) => draw.ticks(-0.3 * span, 0.7 * span, {room}, draw.{words});"
        "const both = (span) => [straight(span), draw.logTicks(0.3, 0.3 + span)];"
        f"console.log(JSON.stringify({json.dumps(spans)}.map(both)));"
    )
    (tmp_path / "package.json").write_text('{"type": "module"}')
    for span, (straight, logarithmic) in zip(spans, json.loads(node_output(script, tmp_path)), strict=True):
        apart = [(b - a) / span * room for a, b in pairwise(straight)]
        assert len(straight) >= 2
        assert len(straight) >= 3 or room < 320
        assert min(apart) > (40.0 if words == "WIDE" else 25.0)
        assert len(logarithmic) >= 2


def test_the_page_asks_nothing_of_the_network() -> None:
    for path in PAGE.iterdir():
        text = path.read_text(encoding="utf-8")
        found = re.findall(r"\b(?:https?|wss?)://[^\s`\"']+", text)
        assert all(one == "ws://${location.host}/socket" for one in found), (path.name, found)
        assert "innerHTML" not in text
        assert "eval(" not in text
