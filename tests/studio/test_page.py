"""The page itself, in Debian's Chromium: it is dragged, read, reloaded and learned with as a person would."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.studio.conftest import CHROMIUM

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, WebSocketRoute

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here to show the page in")


@contextmanager
def served_over(folder: Path) -> Iterator[str]:
    """A studio as `onebend studio` serves it."""
    command = [sys.executable, "-m", "onebend", "studio", str(folder), "--no-open"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    served = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert served.stdout is not None
    found = None
    while found is None and (line := served.stdout.readline()):
        found = re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", line)
    assert found is not None
    yield found[0]
    served.send_signal(signal.SIGINT)
    assert served.wait(30) == 0
    served.stdout.close()


@contextmanager
def browsed(browser: Browser, address: str, refused: tuple[str, ...] = ()) -> Iterator[Page]:
    """A page on it, as on a first visit; what it complains of fails the test, but for answers of the statuses
    `refused`."""
    wrong: list[str] = []
    with browser.new_context(viewport={"width": 1100, "height": 760}) as context:
        shown = context.new_page()
        shown.on("pageerror", lambda error: wrong.append(str(error)))
        shown.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
        shown.goto(address)
        yield shown
    assert not [one for one in wrong if not any(f"status of {status} " in one for status in refused)]


@pytest.fixture(scope="module")
def address(folder: Path) -> Iterator[str]:
    with served_over(folder) as found:
        yield found


@pytest.fixture
def page(browser: Browser, address: str) -> Iterator[Page]:
    with browsed(browser, address) as shown:
        yield shown


def ready(page: Page) -> None:
    page.locator(".big b").wait_for()
    page.locator(".panel:not(.mapping)").wait_for(timeout=30_000)


def dragged(page: Page, x: float, y: float) -> None:
    """The handle, taken from where it is and led to a share of the canvas."""
    box = page.locator(".bend canvas").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + 0.3 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + x * box["width"], box["y"] + y * box["height"], steps=12)
    page.wait_for_timeout(300)
    page.mouse.up()


def force(page: Page) -> float:
    return float(page.locator(".big b").inner_text().replace("−", "-"))


def test_it_listens_on_this_computer_alone(address: str) -> None:
    port = int(address.split(":")[2].split("/")[0])
    others = {str(row[4][0]) for row in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {"127.0.0.1"}
    for host in ("127.0.0.2", *others):
        with pytest.raises(OSError, match=r"refused|unreachable|timed out"):
            socket.create_connection((host, port), timeout=2.0)


def test_drag_the_tip_read_the_force_reload_and_go_on(page: Page) -> None:
    page.goto(f"{page.url}#bend?model=beam")
    page.reload()
    ready(page)
    assert "token" not in page.url
    dragged(page, 0.6, 0.2)
    size = force(page)
    assert size > 0.01
    command = page.locator(".bend .command code").inner_text()
    assert command.startswith("onebend reach beam --goal ")
    page.reload()
    ready(page)
    assert force(page) == size
    assert page.locator(".bend .command code").inner_text() == command
    page.locator(".bend canvas").focus()
    page.keyboard.press("ArrowDown")
    page.wait_for_timeout(300)
    assert page.locator(".bend .command code").inner_text() != command
    page.keyboard.press("Escape")
    page.locator(".big b", has_text=re.compile("^0$")).wait_for()
    largest = page.get_by_label("largest force in N")
    for wrong, marked in (("-1", "true"), ("0", "true"), ("", "true"), ("2", "false")):
        largest.fill(wrong)
        assert largest.get_attribute("aria-invalid") == marked
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.locator("nav a", has_text="Learn").click()
    page.locator(".curve canvas").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.slow
def test_the_first_visit_opens_what_there_is_to_do(
    browser: Browser, address: str, folder: Path, tmp_path: Path
) -> None:
    shutil.copytree(folder / "hung weights", tmp_path / "hung weights")
    with served_over(tmp_path) as unlearned:
        for place, room in ((address, "Bend"), (unlearned, "Recordings")):
            with browsed(browser, place) as page:
                page.locator("nav a[aria-current=page]", has_text=re.compile(f"^{room}$")).wait_for()
                assert page.title().startswith(room)


@pytest.mark.slow
def test_learn_a_recording_then_bend_it(page: Page) -> None:
    page.locator("nav a", has_text="Learn").click()
    row = page.locator(".choice li", has_text="hung weights").first
    row.locator("input").first.check()
    page.locator("input[type=text]").fill("by hand")
    assert page.locator(".learn .command code").inner_text() == "onebend learn 'hung weights' --output 'by hand'"
    page.locator("button.main").click()
    page.locator(".job h2", has_text="Learned").wait_for(timeout=120_000)
    page.locator("h1", has_text="by hand").wait_for()
    assert "results=by+hand" in page.url
    assert page.locator(".verdict .headline").inner_text()
    page.reload()
    page.locator("h1", has_text="by hand").wait_for()
    page.locator(".links a", has_text="Bend it").click()
    ready(page)
    assert page.locator(".toolbar select").input_value() == "by hand"
    dragged(page, 0.6, 0.2)
    assert force(page) > 0.0


@pytest.mark.slow
def test_a_socket_that_drops_comes_back_where_it_was(page: Page) -> None:
    lines: list[WebSocketRoute] = []

    def through(line: WebSocketRoute) -> None:
        lines.append(line)
        line.connect_to_server()

    page.route_web_socket(re.compile("/socket$"), through)
    page.reload()
    ready(page)
    dragged(page, 0.6, 0.25)
    before = force(page)
    lines[-1].close()
    page.locator("#link", has_text="reconnecting").wait_for()
    page.locator("#link", has_text=re.compile("^$")).wait_for(state="attached")
    assert len(lines) == 2
    assert force(page) == before
    dragged(page, 0.6, 0.75)
    assert force(page) != before
