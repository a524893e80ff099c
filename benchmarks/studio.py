"""The studio: how soon its first picture is there, how often a dragged beam is drawn anew, and how late."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, sync_playwright

from benchmarks.startup import bare, model

REPEATS = 3
SECONDS = 4.0  # of dragging
PAUSE = 0.008  # s between two places of the pointer: a mouse of 125 Hz
# The pointer's events are made in the page: those of Playwright wait for each other, and come 20 to 30 times a second.
SWING = """([x, y, reach, long, pause]) => new Promise((done) => {
  const canvas = document.querySelector(".bend canvas"), began = performance.now();
  let moves = 0;
  const swing = setInterval(() => {
    const spent = performance.now() - began, turn = 1.2 * Math.sin(0.0015 * spent);
    const [clientX, clientY] = [x + reach * Math.cos(turn), y - reach * Math.sin(turn)];
    canvas.dispatchEvent(new PointerEvent("pointermove", { clientX, clientY, bubbles: true, buttons: 1 }));
    moves += 1;
    if (spent > long) {
      clearInterval(swing);
      done([spent, moves]);
    }
  }, pause);
})"""
FIRST, RATE, LATE = 1.5, 30.0, 50.0  # s, updates a second, ms: the floors


def served(folder: Path) -> tuple[subprocess.Popen[str], str]:
    """A studio, and its address once it serves."""
    command = [sys.executable, "-m", "onebend", "studio", str(folder), "--no-open"]
    environment = bare() | {"PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None
    for line in process.stdout:
        if found := re.search(r"http://\S+", line):
            return process, found[0]
    raise RuntimeError("the studio did not start")


def ended(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=20)


def drag(page: Page, *, within: bool) -> tuple[float, float, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """Updates and pointer events a second, and the updates' delays [ms], from an event to the frame with its answer."""
    box = page.locator(".bend canvas").bounding_box()
    assert box is not None
    page.evaluate("performance.clearMeasures()")
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    reach = 0.48 if within else 0.2  # of the canvas' height: near the set's edge, or far inside, where no force leads
    page.mouse.move(x + 0.9 * reach * box["height"], y)
    page.mouse.down()
    spent, moves = page.evaluate(SWING, [x, y, reach * box["height"], 1000.0 * SECONDS, 1000.0 * PAUSE])
    page.mouse.up()
    late = np.array(page.evaluate("performance.getEntriesByName('drag').map((one) => one.duration)"))
    return 1000.0 * len(late) / spent, 1000.0 * moves / spent, late


def main() -> None:
    chromium = shutil.which("chromium")
    if chromium is None:
        print("There is no Chromium here: nothing was measured.")
        return
    with tempfile.TemporaryDirectory() as place, sync_playwright() as play:
        (Path(place) / "beam").mkdir()
        model(Path(place) / "beam")
        (Path(place) / "beam" / "summary.json").write_text("{}", encoding="utf-8")
        browser = play.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        first = []
        for i in range(REPEATS):
            began = time.perf_counter()
            process, address = served(Path(place))
            page = browser.new_page()
            page.goto(address)
            page.locator(".big b").wait_for()
            first.append(time.perf_counter() - began)
            if i < REPEATS - 1:
                page.close()
                ended(process)
        page.locator(".panel:not(.mapping)").wait_for()
        rows = [
            (words, *drag(page, within=within)) for words, within in (("at the edge", True), ("out of reach", False))
        ]
        browser.close()
        ended(process)
    hertz = min(moves for _, _, moves, _ in rows)
    print(f"Measured in Chromium, which runs on the same cores; the pointer moves {hertz:.0f} times a second.\n")
    print("| what | value | floor |\n| --- | --- | --- |")
    print(f"| from the command to the bent beam in the page, best of {REPEATS} | {min(first):.2f} s | {FIRST:g} s |")
    for words, rate, _, late in rows:
        print(f"| a drag {words}: updates a second | {rate:.0f} | {RATE:g} |")
        half, most = np.percentile(late, [50, 95])
        print(f"| from pointer to drawn answer: median, 95 % | {half:.0f}, {most:.0f} ms | {LATE:g} ms |")


if __name__ == "__main__":
    main()
