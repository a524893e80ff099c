"""The rooms Recordings and Loop in Chromium, as a person uses them."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.studio.conftest import CHROMIUM, ROOT
from tests.studio.test_page import browsed, served_over

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, WebSocketRoute

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here to show the page in")
TRAIN = ROOT / "examples" / "linear-beam" / "train"


@pytest.fixture(scope="module")
def own_folder(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("rooms page")
    shutil.copytree(TRAIN, place / "train")
    shutil.copytree(folder / "beam", place / "beam")
    (place / "raw").mkdir()
    shutil.copy(TRAIN / "video.mp4", place / "raw")
    shutil.copy(TRAIN / "force.csv", place / "raw")
    return place


@pytest.fixture(scope="module")
def address(own_folder: Path) -> Iterator[str]:
    with served_over(own_folder) as found:
        yield found


@pytest.fixture
def page(browser: Browser, address: str) -> Iterator[Page]:
    with browsed(browser, address) as shown:
        yield shown


def opened(page: Page, where: str) -> None:
    page.goto(f"{page.url.partition('#')[0]}#{where}")
    page.reload()


def narrow(page: Page) -> bool:
    page.set_viewport_size({"width": 390, "height": 800})
    page.wait_for_timeout(100)
    return bool(page.evaluate("document.documentElement.scrollWidth") <= 390)


def quick(page: Page, locator: str) -> float:
    """ms from a key to what it brings, by the page's own clock."""
    return float(
        page.evaluate(
            """async (locator) => {
              const area = document.querySelector(".code textarea"), began = performance.now();
              area.value += "\\n[brush]";
              area.dispatchEvent(new Event("input"));
              while (![...document.querySelectorAll(locator)].some((one) => one.textContent.includes("brush")))
                await new Promise((done) => setTimeout(done, 2));
              return performance.now() - began;
            }""",
            locator,
        )
    )


@pytest.mark.slow
def test_a_recording_is_mended_while_it_is_checked_and_saved(page: Page, own_folder: Path) -> None:
    path = own_folder / "train" / "recording.toml"
    before = path.read_text(encoding="utf-8")
    opened(page, "recordings?name=train")
    page.locator(".first canvas").wait_for()
    assert "Tags in the first frame: 0, 1, 2, 3." in page.locator(".first figcaption").inner_text()
    area = page.locator(".code textarea")
    assert area.input_value() == before
    assert min(quick(page, ".mistakes li") for _ in range(3)) < 200
    area.fill(before.replace("length_m", "lenght_m"))
    wrong = page.locator(".mistakes li", has_text="Did you mean length_m?")
    wrong.wait_for()
    line = 1 + before[: before.index("length_m")].count("\n")
    assert wrong.locator("button").inner_text() == f"line {line}"
    assert page.locator(".numbers .wrong").all_inner_texts()[-1] == str(line)
    wrong.locator("button").click()
    picked = page.evaluate("(one => one.value.slice(one.selectionStart, one.selectionEnd))(document.activeElement)")
    assert "lenght_m" in picked
    entries = before.split("\n[")
    last = max(i for i, entry in enumerate(entries) if entry.startswith("[tags.on_beam]]"))
    area.fill("\n[".join(entries[:last] + entries[last + 1 :]))
    page.locator(".first figcaption", has_text="Not in recording.toml: 3.").wait_for()
    page.get_by_role("button", name="Use these tags").click()
    assert area.input_value().count("id = 3\ns = #") == 1
    page.locator(".mistakes li", has_text="s is empty").wait_for()
    assert not page.get_by_role("button", name="Use these tags").is_visible()
    area.fill(before.replace("length_m", "lenght_m"))
    wrong.wait_for()
    page.reload()  # what was typed is still there, and not on disk
    wrong.wait_for()
    assert path.read_text(encoding="utf-8") == before
    area.fill(before + "# one line more\n")
    page.locator(".state", has_text="no mistake").wait_for()
    area.press("Control+s")
    page.locator(".state", has_text="as on disk").wait_for()
    assert path.read_text(encoding="utf-8") == before + "# one line more\n"
    area.fill(before + "# mine\n")
    path.write_text(before + "# theirs\n", encoding="utf-8")
    page.get_by_role("button", name="Save").click()
    page.locator(".conflict").wait_for()
    assert path.read_text(encoding="utf-8") == before + "# theirs\n"
    assert narrow(page)
    page.get_by_role("button", name="take the file's text").click()
    assert area.input_value() == before + "# theirs\n"
    path.write_text(before, encoding="utf-8")


@pytest.mark.slow
def test_what_is_open_stays_open_and_what_cannot_be_opened_says_why(
    browser: Browser, address: str, own_folder: Path
) -> None:
    with browsed(browser, address, refused=("413", "422")) as page:
        stays_open(page, own_folder)


def stays_open(page: Page, own_folder: Path) -> None:
    for name in ("away", "bare"):
        (own_folder / name).mkdir()
        shutil.copy(TRAIN / "video.mp4", own_folder / name)
    (own_folder / "bare" / "recording.toml").write_text('format = 1\n[video]\nfile = "video.mp4"\n', encoding="utf-8")
    shutil.copy(TRAIN / "recording.toml", own_folder / "away")
    opened(page, "recordings?name=away")
    page.locator(".first figcaption", has_text=re.compile(r"0, 1, 2, 3\.$")).wait_for()
    page.locator(".pick", has_text="bare").click()
    page.locator(".first figcaption", has_text="Not in recording.toml: 0, 1, 2, 3.").wait_for()
    page.locator(".pick", has_text="away").click()
    page.locator("h1", has_text="away").wait_for()
    area = page.locator(".code textarea")
    area.fill("x" * 300_000)
    page.locator(".state", has_text="not checked: At most 262144 bytes").wait_for()
    area.fill("# mine\n")
    shutil.rmtree(own_folder / "away")
    before = {path: path.read_bytes() for path in own_folder.rglob("recording.toml")}
    (own_folder / "bare" / "recording.toml").rename(own_folder / "kept.toml")
    new = "fetch('/api/recordings/new', {method: 'POST', headers: {'Content-Type': 'application/json'}, body: "
    page.evaluate(f"""{new} '{{"name": "bare"}}'}})""")
    page.locator(".state", has_text="its folder is gone: nothing can be saved").wait_for()
    (own_folder / "kept.toml").rename(own_folder / "bare" / "recording.toml")
    area.press("End")
    area.press("y")
    area.press("Control+s")
    page.wait_for_timeout(200)
    assert (page.locator("h1").inner_text(), area.input_value()) == ("away", "# mine\ny")
    assert {path: path.read_bytes() for path in own_folder.rglob("recording.toml")} == before
    (own_folder / "bare" / "recording.toml").write_bytes(b"format = 1\n# \xff\n")
    page.locator(".pick", has_text="bare").click()
    page.locator(".empty", has_text="bare cannot be opened here. recording.toml, line 2: no UTF-8").wait_for()
    (own_folder / "bare" / "recording.toml").write_bytes(b"format = 1\n")
    page.evaluate("window.dispatchEvent(new Event('focus'))")
    page.locator("h1", has_text="bare").wait_for()
    shutil.rmtree(own_folder / "bare")


@pytest.mark.slow
def test_long_lines_are_folded_beside_their_numbers(page: Page, own_folder: Path) -> None:
    path = own_folder / "train" / "recording.toml"
    before = path.read_text(encoding="utf-8")
    opened(page, "recordings?name=train")
    page.locator(".first canvas").wait_for()
    long = "length_m = 0.15  # " + "as long as a comment may be, " * 12
    page.locator(".code textarea").fill(before.replace("length_m = 0.15", long).replace("mass_kg", "mas_kg"))
    page.locator(".mistakes li", has_text="mas_kg").wait_for()
    line = 1 + before[: before.index("mass_kg")].count("\n")
    for width in (1100, 390):
        page.set_viewport_size({"width": width, "height": 800})
        page.wait_for_timeout(300)
        assert page.evaluate("(one => one.scrollWidth <= one.clientWidth)(document.querySelector('.code textarea'))")
        number, text = (page.locator(f".code {one}").nth(line - 1) for one in (".numbers span", ".under-text p"))
        places = [one.bounding_box() for one in (number, text)]
        assert places[0] is not None
        assert places[1] is not None
        assert abs(places[0]["y"] - places[1]["y"]) < 1.0
        assert number.get_attribute("class") == "wrong"
        folded = page.locator(".numbers span").nth(line - 2).bounding_box()
        assert folded is not None
        assert folded["height"] > 3 * places[0]["height"]
    page.get_by_role("button", name="back to the file").click()


@pytest.mark.slow
def test_two_tabs_agree_on_what_was_saved(page: Page, own_folder: Path) -> None:
    path = own_folder / "train" / "recording.toml"
    before = path.read_text(encoding="utf-8")
    from playwright.sync_api import expect

    other = page.context.new_page()
    for one in (page, other):
        one.goto(f"{page.url.partition('#')[0]}#recordings?name=train")
        one.locator(".first canvas").wait_for()
    page.locator(".code textarea").fill(before + "# from the first tab\n")
    page.get_by_role("button", name="Save").click()
    expect(other.locator(".code textarea")).to_have_value(re.compile("# from the first tab\n$"))
    other.locator(".code textarea").fill(before + "# from the other\n")
    page.locator(".code textarea").fill(before)
    page.get_by_role("button", name="Save").click()
    other.locator(".conflict").wait_for()
    assert other.locator(".code textarea").input_value() == before + "# from the other\n"
    assert path.read_text(encoding="utf-8") == before
    other.close()


@pytest.mark.slow
def test_another_address_of_the_same_room_is_gone_to(page: Page, own_folder: Path) -> None:
    shutil.copytree(own_folder / "train", own_folder / "another")
    opened(page, "recordings?name=train")
    page.locator("h1", has_text="train").wait_for()
    page.evaluate("location.hash = '#recordings?name=another'")  # as typed into the browser's line
    page.locator("h1", has_text="another").wait_for()
    page.evaluate("location.hash = '#recordings'")  # the room's own link: all stays
    page.wait_for_timeout(200)
    assert page.locator("h1").inner_text() == "another"
    shutil.rmtree(own_folder / "another")


@pytest.mark.slow
def test_a_film_is_begun_and_a_recording_checked(page: Page, own_folder: Path) -> None:
    opened(page, "recordings")
    page.get_by_role("button", name="into raw").click()
    page.locator("h1", has_text="raw").wait_for()
    page.locator(".mistakes li", has_text="length_m is empty").wait_for()
    page.locator(".first canvas").wait_for()
    assert (own_folder / "raw" / "recording.toml").is_file()
    page.locator(".pick", has_text="train").click()
    page.locator(".state", has_text="no mistake").wait_for()
    page.get_by_role("button", name="Check the recording").click()
    page.locator(".findings img").wait_for(timeout=90_000)
    assert page.evaluate("document.querySelector('.findings img').decode().then(() => true)")
    assert "0, 1, 2, 3" in page.locator(".findings").inner_text()
    assert "check train --output train/check.png" in page.locator(".check-room .command").inner_text()
    page.reload()
    page.locator(".findings img").wait_for()


@pytest.mark.slow
def test_a_goal_is_chosen_by_keys_simulated_and_played(page: Page) -> None:
    lines: list[WebSocketRoute] = []

    def through(line: WebSocketRoute) -> None:
        lines.append(line)
        line.connect_to_server()

    page.route_web_socket(re.compile("/socket$"), through)
    opened(page, "loop?model=beam")
    goal = page.get_by_label("goal, x in mm")
    page.locator(".command code", has_text="--goal").wait_for()
    first = float(goal.input_value())
    page.locator(".stage > canvas").focus()
    page.keyboard.press("ArrowRight")
    assert float(goal.input_value()) > first
    run = page.locator(".toolbar button.main")
    for label, wrong in (
        ("frames a second", "-1"), ("largest force in N", "-0.2"), ("goal, x in mm", ""), ("goal, x in mm", "5000"),
    ):  # fmt: skip
        field = page.get_by_label(label)
        before = field.input_value()
        field.fill(wrong)
        assert field.get_attribute("aria-invalid") == "true"
        assert run.is_disabled()
        assert label in run.inner_text()
        field.fill(before)
        assert not run.is_disabled()
    page.get_by_label("duration in s").fill("2")
    command = page.locator(".loop .command code").inner_text()
    assert command.startswith("onebend loop beam --goal ")
    assert command.endswith("--k-error 0.3 --delay-ms 50 --fps 30 --noise-mm 0.05 --duration-s 2")
    page.get_by_role("button", name="Simulate", exact=True).click()
    page.locator(".outcome tr").nth(3).wait_for(timeout=90_000)
    page.locator(".clock", has_text="2.00 s").wait_for()  # it played by itself
    page.locator(".job").wait_for(state="detached")  # until then the table is made anew
    rows = page.locator(".outcome tr").all_inner_texts()
    lines[-1].close()
    page.locator("#link", has_text="reconnecting").wait_for()
    page.locator("#link", has_text=re.compile("^$")).wait_for(state="attached")
    assert page.locator(".outcome tr").all_inner_texts() == rows
    page.get_by_label("time").fill("0.5")
    assert page.locator(".clock").inner_text() == "0.50 s"
    page.reload()
    page.locator(".outcome tr").nth(3).wait_for()
    assert page.locator(".outcome tr").all_inner_texts() == rows
    assert page.locator(".loop .command code").inner_text() == command
    page.get_by_label("delay in ms").fill("80")
    page.locator(".status", has_text="simulate again").wait_for()
    assert narrow(page)
