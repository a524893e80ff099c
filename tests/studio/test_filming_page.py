"""The room Record in Debian's Chromium: a played film is recorded, learned from and bent in one run of the page."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from onebend.report.overview import overview
from tests.studio.conftest import CHROMIUM
from tests.studio.test_page import browsed, dragged, force, ready, served_over

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, WebSocketRoute

EXAMPLE = Path(__file__).parents[2] / "examples" / "linear-beam"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here to show the page in"),
]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings to play."""
    return Path(shutil.copytree(EXAMPLE, tmp_path_factory.mktemp("filming") / "lab"))


@pytest.fixture(scope="module")
def address(lab: Path) -> Iterator[str]:
    with served_over(lab) as found:
        yield found


@pytest.fixture
def page(browser: Browser, address: str) -> Iterator[Page]:
    with browsed(browser, address) as shown:
        yield shown


def filled(page: Page, out: str, film: str) -> None:
    """The room Record with what is to be played."""
    page.locator("nav a[data-room=record]").click()
    page.locator(f"option[value='{film}']").first.wait_for(state="attached")
    page.get_by_label("folder to record into").fill(out)
    for one in ("train", "fast", film):
        page.get_by_label("the beam is that of").select_option(one)
        assert page.get_by_label("the beam is that of").input_value() == one
    for label, kind in (("camera", "film"), ("force sensor", "log")):
        page.get_by_label(label, exact=True).select_option(f"{kind}:{film}")
        assert not page.get_by_label(f"{label} as text").is_visible()


def fits(page: Page, width: int) -> bool:
    page.set_viewport_size({"width": width, "height": 800})
    return bool(page.evaluate("document.documentElement.scrollWidth") <= width)


def painted(page: Page) -> str:
    """What the camera's picture shows now."""
    return str(page.locator(".camera canvas").evaluate("(node) => node.toDataURL()"))


def test_record_learn_drag_read_reload_and_go_on(page: Page, lab: Path) -> None:
    from playwright.sync_api import expect

    filled(page, "push", "fast")
    page.get_by_label("play as fast as it can be read").check()
    command = page.locator(".record .command code").inner_text()
    assert command == "onebend record push --camera film:fast --force log:fast --like fast --fast"
    page.get_by_label("folder to record into").press("Enter")
    page.locator("h1", has_text="Recorded push").wait_for(timeout=60_000)
    page.locator(".ended .words dt", has_text="force log").wait_for(timeout=60_000)
    assert overview(lab / "push").faults == ()
    assert page.get_by_label("folder to record into").input_value() == "push-2"
    page.locator("a", has_text="Learn it").click()
    assert page.locator(".choice li", has_text="push").locator("input").first.is_checked()
    assert page.locator(".learn .command code").inner_text() == "onebend learn push --output push-results"
    page.locator("button.main").click()
    page.locator(".job h2", has_text="Learned").wait_for(timeout=180_000)
    assert page.locator(".verdict .headline").inner_text()
    page.locator(".links a", has_text="Bend it").click()
    ready(page)
    dragged(page, 0.6, 0.2)
    size, bent = force(page), page.locator(".bend .command code").inner_text()
    assert size > 0.01
    page.reload()
    ready(page)
    assert (force(page), page.locator(".bend .command code").inner_text()) == (size, bent)
    page.locator(".bend canvas").focus()
    page.keyboard.press("ArrowDown")
    page.wait_for_timeout(300)
    assert page.locator(".bend .command code").inner_text() != bent
    page.locator("nav a[data-room=record]").click()
    page.locator("h1", has_text="Recorded push").wait_for()
    page.locator("button", has_text="Another push of this beam").click()
    expect(page.get_by_label("folder to record into")).to_have_value("push-2")
    expect(page.get_by_label("the beam is that of")).to_have_value("push")
    assert fits(page, 390)


def test_what_can_be_chosen_is_listed_and_all_else_is_text(page: Page) -> None:
    page.locator("nav a[data-room=record]").click()
    camera, force = (page.get_by_label(label, exact=True) for label in ("camera", "force sensor"))
    page.locator("option[value='film:train']").first.wait_for(state="attached")
    assert {"train", "fast"} <= set(camera.locator("optgroup[label='a recording, played'] option").all_inner_texts())
    camera.select_option("film:train")  # brings its log and its beam
    assert force.input_value() == "log:train"
    assert page.get_by_label("the beam is that of").input_value() == "train"
    force.select_option("ati:192.168.1.1")
    address = page.get_by_label("force sensor as text")
    address.fill("ati:10.0.0.7,rate=1000")
    assert "--force ati:10.0.0.7,rate=1000" in page.locator(".record .command code").inner_text()
    page.reload()
    page.locator("option[value='film:train']").first.wait_for(state="attached")
    assert camera.input_value() == "film:train"
    assert address.input_value() == "ati:10.0.0.7,rate=1000"
    force.select_option(label="none: film alone")
    assert not address.is_visible()
    assert "--force" not in page.locator(".record .command code").inner_text()
    assert fits(page, 390)


def test_a_recording_goes_on_whoever_looks_and_ends_by_the_keyboard(page: Page, lab: Path) -> None:
    lines: list[WebSocketRoute] = []

    def through(line: WebSocketRoute) -> None:
        lines.append(line)
        line.connect_to_server()

    page.route_web_socket(re.compile("/socket$"), through)
    page.reload()
    filled(page, "slowly", "train")
    page.locator("summary", has_text="more").click()
    page.get_by_label("learn no k(s) meanwhile").check()
    command = page.locator(".record .command code").inner_text()
    assert command == "onebend record slowly --camera film:train --force log:train --like train --no-learning"
    page.locator(".record button[type=submit]").press("Enter")
    page.locator(".stages .now", has_text="push").wait_for(timeout=30_000)
    picture = painted(page)
    assert float(page.locator(".numbers .big b").inner_text()) >= 0.0
    assert "4 of 4" in page.locator(".numbers").inner_text()
    lines[-1].close()
    page.locator("#link", has_text="reconnecting").wait_for()
    page.locator("#link", has_text=re.compile("^$")).wait_for(state="attached")
    page.locator("h1", has_text="Recording slowly").wait_for()
    page.wait_for_function("(before) => document.querySelector('.camera canvas').toDataURL() !== before", arg=picture)
    other = page.context.new_page()
    other.goto(page.url)
    other.reload()
    other.locator("h1", has_text="Recording slowly").wait_for()
    other.locator(".camera canvas").wait_for()
    page.emulate_media(color_scheme="dark")
    assert fits(page, 390)
    page.locator("button", has_text="Finish").press("Enter")
    for tab in (page, other):
        tab.locator("h1", has_text="Recorded slowly").wait_for(timeout=30_000)
        tab.locator("a", has_text="Learn it").wait_for(timeout=30_000)
        assert tab.locator(".ended .headline").inner_text() == "It was stopped."  # and no advice of the push
        assert not tab.locator(".advice").is_visible()
        assert not tab.locator(".numbers").is_visible()
    assert fits(page, 390)
    assert overview(lab / "slowly").faults == ()
