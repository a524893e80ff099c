"""Draws the pictures of docs/studio.md: each room of the studio, shown in Chromium. `make picture` runs it.

It needs the development environment (`make test` makes it), Debian's Chromium and free cores, for the room Record
plays a film at its own pace. Rooms that are named (bend, hand, learn, recordings, loop, record) are drawn alone.
"""

import io
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).parents[1]
TARGET = ROOT / "docs" / "images"
COLOURS = 128  # a picture that is read over a slow line
ONEBEND = (sys.executable, "-m", "onebend")


@contextmanager
def studio(folder: Path) -> Iterator[str]:
    """A studio over two recordings of the example's beam and what was learned of one; its address."""
    for name in ("train", "fast"):
        shutil.copytree(ROOT / "examples" / "linear-beam" / name, folder / name)
    shutil.copytree(ROOT / "examples" / "hung-weights", folder / "hung-weights")
    words = ("learn", "train", "-o", "linear-beam", "--validate", "fast", "--quiet")
    subprocess.run([*ONEBEND, *words], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    process = subprocess.Popen([*ONEBEND, "studio", ".", "--no-open"], cwd=folder, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield next(found[0] for line in process.stdout if (found := re.search(r"http://\S+", line)))
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=20)


def record(page: Page) -> None:
    page.locator("option[value=fast]").first.wait_for(state="attached")
    page.get_by_label("folder to record into").fill("second-push")
    page.get_by_label("the beam is that of").select_option("train")
    page.get_by_label("camera", exact=True).select_option("film:train")
    page.get_by_label("folder to record into").press("Enter")
    page.locator(".stages .now", has_text="push").wait_for(timeout=60_000)
    page.locator(".curve canvas").wait_for(timeout=60_000)
    page.locator(".advice", has_text="far enough").wait_for(timeout=60_000)


def recordings(page: Page) -> None:
    text = page.locator(".code textarea")
    text.wait_for()
    page.locator(".first canvas").wait_for()
    wrong = text.input_value().replace("length_m = 0.15", 'length_m = "150 mm"').replace("mass_kg", "mas_kg")
    text.fill(wrong.replace("id = 2\n", "id = 22\n"))
    page.locator(".mistakes", has_text="mas_kg").wait_for()
    text.evaluate("(node) => { node.setSelectionRange(0, 0); node.blur(); node.scrollTop = 0; }")


def learn(page: Page) -> None:
    page.locator(".curve canvas").first.wait_for()
    page.wait_for_timeout(500)


def bend(page: Page) -> None:
    page.locator(".big b").wait_for()
    page.locator(".panel:not(.mapping)").wait_for()
    dragged(page, (0.72, 0.40), (0.6708, 0.2795))


def hand(page: Page) -> None:
    bend(page)
    page.locator("button", has_text="hand at the end").click()
    page.get_by_label("largest force in N").fill("10")
    page.get_by_label("largest force in N").press("Enter")
    page.wait_for_timeout(500)
    dragged(page, (0.634, 0.307), (0.622, 0.344))


def dragged(page: Page, begin: tuple[float, float], end: tuple[float, float]) -> None:
    """Drag the beam's end over the canvas, in parts of its size, and wait for the ellipse or the edge."""
    box = page.locator(".bend canvas").bounding_box()
    assert box is not None
    (x, y), (to_x, to_y) = ((box["x"] + u * box["width"], box["y"] + v * box["height"]) for u, v in (begin, end))
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(to_x, to_y, steps=60)
    page.wait_for_timeout(500)
    page.mouse.up()
    page.wait_for_timeout(2500)


def loop(page: Page) -> None:
    page.wait_for_timeout(1500)  # the outline of what can be reached
    page.get_by_role("button", name="Simulate", exact=True).click()
    page.locator(".outcome tr").nth(3).wait_for(timeout=120_000)
    page.wait_for_timeout(1500)
    page.get_by_label("time").fill("0.9")


SHOTS: tuple[tuple[str, str, Callable[[Page], None], str, tuple[int, int]], ...] = (
    ("bend", "bend?model=linear-beam", bend, "light", (1280, 800)),
    ("hand", "bend?model=linear-beam", hand, "light", (1280, 800)),
    ("learn", "learn?results=linear-beam&from=train&check=fast", learn, "dark", (1280, 1000)),
    ("recordings", "recordings?name=train", recordings, "light", (1100, 690)),
    ("loop", "loop?model=linear-beam", loop, "light", (1100, 960)),
    ("record", "record", record, "light", (1100, 1080)),
)

chromium = shutil.which("chromium")
if chromium is None:
    sys.exit("There is no Chromium here to show the studio in: apt install chromium.")
with tempfile.TemporaryDirectory() as place, studio(Path(place)) as address, sync_playwright() as play:
    browser = play.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
    for name, room, do, scheme, (width, height) in SHOTS:
        if sys.argv[1:] and name not in sys.argv[1:]:
            continue
        page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
        page.goto(address)
        page.goto(f"{address.split('/?')[0]}/#{room}")
        page.reload()
        do(page)
        page.wait_for_timeout(500)
        picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        picture.quantize(COLOURS).save(TARGET / f"studio-{name}.png", optimize=True)
        print(f"{TARGET / f'studio-{name}.png'}: {(TARGET / f'studio-{name}.png').stat().st_size / 1000:.0f} kB")
        page.close()
    browser.close()
