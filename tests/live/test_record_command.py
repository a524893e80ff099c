"""`onebend record`: what it shows, writes and refuses."""

from __future__ import annotations

import json
import shutil
import signal
import threading
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner, Result

from onebend.cli import app
from onebend.cli.common import percent, stopped_by_hand
from onebend.errors import RecordingError
from onebend.live.commands import StateView, recording_line, recording_screen
from onebend.live.guidance import CaptureOutcome, CaptureState, TagView, outcome_words
from onebend.live.recording_folder import FilmWriter
from onebend.report.overview import overview
from tests.attack.hostile_films import CASES
from tests.live.streamed import frames, log, toml
from tests.recording.filmed import HEIGHT, WIDTH


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording to play."""
    folder = tmp_path_factory.mktemp("original")
    film = FilmWriter(folder / "video.mp4", (WIDTH, HEIGHT))
    for frame in frames():
        film.write(frame.luma, frame.time)
    film.close()
    rows = np.column_stack([log().time, log().force])
    np.savetxt(folder / "force.csv", rows, "%.5f", ",", header="time_s,fx_N,fy_N", comments="")
    (folder / "recording.toml").write_text(toml(), encoding="utf-8")
    return folder


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(app, ["record", *map(str, words)])


@pytest.mark.slow
def test_a_played_recording_becomes_one(original: Path, tmp_path: Path) -> None:
    done = run(tmp_path / "new", "--play", original, "--fast", "--no-learning")
    assert done.exit_code == 0, done.output
    assert "Recorded" in done.stdout
    assert f"onebend check {tmp_path / 'new'}" in done.stdout
    assert "touch nothing: the first rest takes" in done.stderr
    assert "push: further" in done.stderr
    assert overview(tmp_path / "new").faults == ()


def test_an_earlier_recording_is_replaced_only_when_asked(original: Path, tmp_path: Path) -> None:
    words = ("--play", str(original), "--fast", "--no-learning", "--now", "--longest-s", "1")
    assert run(tmp_path / "new", *words).exit_code == 0
    film = tmp_path / "new" / "video.mp4"
    before = film.read_bytes()
    refused = run(tmp_path / "new", *words)
    assert refused.exit_code == 2
    assert "is there already" in refused.stderr
    assert film.read_bytes() == before
    film.write_bytes(b"mine")
    assert run(tmp_path / "new", *words, "--overwrite").exit_code == 0
    assert film.read_bytes() == before
    assert overview(tmp_path / "new").rows


def test_json_is_one_object(original: Path, tmp_path: Path) -> None:
    words = ("--play", original, "--fast", "--no-learning", "--json", "--longest-s", 2)
    done = run(tmp_path / "new", *map(str, words))
    told = json.loads(done.stdout)
    assert (told["stage"], told["whole"], told["half_width"]) == ("push", False, None)
    assert told["ended"].startswith("it lasted 2 s")
    assert told["frames"] > 20
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "--camera is missing"),
        (("--camera", "/dev/video99"), "names a [force], and no sensor is given"),
        (("--camera", "/dev/video99", "--force", "log:PLAYED"), "There is no such camera. Plug it in"),
        (("--camera", "disk:0"), "there is no such source"),
        (("--camera", "film:PLAYED", "--force", "log:PLAYED", "--until", "much"), "--until much: write how exactly"),
        (("--camera", "film:"), "nothing stands behind the colon"),
        (("--camera", "film:PLAYED", "--force", "serial:/dev/ttyUSB9"), "Name forces as fx_N"),
        (("--camera", "film:/nowhere", "--force", "log:PLAYED"), "there is no such film"),
        (("--play", "PLAYED/force.csv"), "force.csv: this is no recording, it holds no recording.toml."),
    ],
)
def test_what_cannot_be_recorded_says_what_to_do(
    original: Path, tmp_path: Path, words: tuple[str, ...], says: str
) -> None:
    (tmp_path / "recording.toml").write_text(toml(), encoding="utf-8")
    done = run(tmp_path, *(word.replace("PLAYED", str(original)) for word in words))
    assert done.exit_code == 2
    assert says in " ".join(done.stderr.split())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["recording.toml"]


def test_a_folder_without_a_description_is_told_to_make_one(original: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    done = run(tmp_path / "empty", "--camera", f"film:{original}")
    assert done.exit_code == 2
    assert "onebend new" in done.stderr


def test_a_start_that_failed_is_begun_again_with_the_same_words(original: Path, tmp_path: Path) -> None:
    words = (tmp_path / "new", "--like", original, "--force", f"log:{original}", "--camera")
    for _ in range(2):
        failed = run(*words, "/dev/video99")
        assert failed.exit_code == 2
        assert "There is no such camera" in failed.stderr
    done = run(*words, f"film:{original}", "--fast", "--no-learning", "--now", "--longest-s", "1")
    assert done.exit_code == 0, done.stderr


def test_a_film_that_ends_in_damage_ends_in_one_sentence(original: Path, tmp_path: Path) -> None:
    shutil.copytree(original, tmp_path / "rec")
    next(case for case in CASES if case.name == "every packet twice").harm(tmp_path / "rec")
    done = run(tmp_path / "new", "--play", tmp_path / "rec", "--fast", "--no-learning", "--now", "--quiet")
    assert done.exit_code == 2
    assert "does not rise. Write it anew." in done.stderr.replace("\n", " ")


def test_another_description_is_not_replaced_by_like(original: Path, tmp_path: Path) -> None:
    mine = tmp_path / "recording.toml"
    mine.write_text(toml() + "# mine\n", encoding="utf-8")
    done = run(tmp_path, "--camera", f"film:{original}", "--force", f"log:{original}", "--like", original)
    assert done.exit_code == 2
    assert "exists already. Leave out --like" in " ".join(done.stderr.split())
    assert mine.read_text(encoding="utf-8").endswith("# mine\n")
    done = run(mine, "--camera", f"film:{original}", "--force", f"log:{original}", "--like", original)
    assert "is not a folder" in " ".join(done.stderr.split())


@pytest.mark.parametrize(("camera", "force"), [("film:MINE", "log:MINE"), ("film:PLAYED", "csv:MINE/force.csv")])
def test_what_is_read_is_not_replaced_even_when_asked(original: Path, tmp_path: Path, camera: str, force: str) -> None:
    mine = tmp_path / "mine"
    shutil.copytree(original, mine)
    before = {path.name: path.read_bytes() for path in mine.iterdir()}
    specs = [spec.replace("MINE", str(mine)).replace("PLAYED", str(original)) for spec in (camera, force)]
    done = run(mine, "--camera", specs[0], "--force", specs[1], "--fast", "--no-learning", "--now", "--overwrite")
    assert done.exit_code == 2, done.output
    assert "would be replaced" in " ".join(done.stderr.split())
    assert {path.name: path.read_bytes() for path in mine.iterdir()} == before


def test_a_film_that_ends_before_its_picture_was_good_says_why(original: Path, tmp_path: Path) -> None:
    film = FilmWriter(tmp_path / "short.mp4", (WIDTH, HEIGHT))
    for i, level in enumerate((0, 0, 0)):
        film.write(np.full((HEIGHT, WIDTH), level, np.uint8), i / 30.0)
    film.close()
    specs = ("--camera", f"film:{tmp_path / 'short.mp4'}", "--force", f"log:{original}", "--fast", "--quiet")
    done = run(tmp_path / "new", "--like", original, *specs)
    assert done.exit_code == 2
    said = " ".join(done.stderr.split())
    assert "to its end before the picture was good: the picture is dark and shows no tag" in said
    assert "Nothing was recorded. To film whatever is wrong with the picture, add --now." in said


def test_the_tables_of_the_beam_are_copied_with_its_description(original: Path, tmp_path: Path) -> None:
    like = tmp_path / "like"
    like.mkdir()
    (like / "mass.csv").write_text("s,kg_per_m\n0,0.5\n1,0.4\n")
    text = toml().replace("[tags]", 'mass_file = "mass.csv"\n[tags]')
    (like / "recording.toml").write_text(text, encoding="utf-8")
    specs = (
        "--camera",
        f"film:{original}",
        "--force",
        f"log:{original}",
        "--fast",
        "--no-learning",
        "--longest-s",
        "1",
    )
    done = run(tmp_path / "new", "--like", like, *specs, "--quiet")
    assert done.exit_code == 0, done.stderr
    assert done.stderr == ""
    assert (tmp_path / "new" / "mass.csv").read_text() == (like / "mass.csv").read_text()


@pytest.mark.parametrize(("text", "share"), [("5%", 0.05), ("12.5", 0.125), ("100%", 1.0)])
def test_a_percentage_is_a_share(text: str, share: float) -> None:
    assert percent(text) == pytest.approx(share)
    assert np.isnan(percent(None))
    for wrong in ("0%", "500%", "five", "nan"):
        with pytest.raises(RecordingError, match="as 5%"):
            percent(wrong)


def test_an_interrupt_ends_the_film_and_a_second_one_interrupts() -> None:
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        interrupted_after(1)
        interrupted_after(2)
    finally:
        signal.signal(signal.SIGINT, usual)


def interrupted_after(times: int) -> None:
    before = signal.getsignal(signal.SIGINT)
    with stopped_by_hand(times) as (stop, begin):
        assert not begin.is_set()
        for _ in range(times):
            stop.clear()
            signal.raise_signal(signal.SIGINT)
            assert stop.is_set()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
    found = []
    other = threading.Thread(target=lambda: found.append(stopped_by_hand().__enter__()))
    other.start()
    other.join()
    assert len(found) == 1  # where signals cannot be caught, it does without


SQUARE = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
STATE = CaptureState(
    "push",
    advice=("further: the tip has moved by 20 % of the length, and 50 % is wanted",),
    tags=(TagView(3, 1.0, 30.0 * SQUARE, False), TagView(7, 0.5, np.full((4, 2), np.nan), False)),
    force=np.array([0.1, -0.25]),
    tare=np.array([0.5, 0.5]),
    displacement=0.15,
    largest=0.2,
    half_width=0.084,
    until=0.05,
    seconds=12.3,
    frames=369,
    drops=2,
    samples=6150,
    clock_sd=4e-4,
    bytes=3_000_000,
    disk_left=5e10,
)


def test_the_screen_shows_what_is_known() -> None:
    console = Console(file=StringIO(), width=100)
    console.print(recording_screen(STATE))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    for part in (
        "▶ push",
        "✓ first rest",
        "· last rest",
        "→ further",
        "3: 30 px, 7: not seen",
        "15 % of the length; farthest 20 %",
        "+0.100, -0.250 N",
        "± 8.4 % (95 %, median), wanted ± 5 %",
        "369 frames, 2 missing",
        "clocks to 0.4 ms",
        "50.0 GB left",
        "Ctrl-C ends it",
    ):
        assert part in text, part


def test_a_terminal_is_renewed_and_a_pipe_gets_a_line_for_what_is_new() -> None:
    for terminal in (True, False):
        stream = StringIO()
        with StateView(
            Console(file=stream, width=100, force_terminal=terminal), recording_screen, recording_line
        ) as view:
            for share in (20, 21, 22):
                advice = (f"further: the tip has moved by {share} % of the length",)
                view.show(CaptureState("push", advice=advice, seconds=float(share)))
        assert stream.getvalue().count("further") >= 1
        if not terminal:
            assert stream.getvalue() == "  20.0 s  push: further: the tip has moved by 20 % of the length\n"
    with StateView(None, recording_screen, recording_line) as nothing:
        nothing.show(STATE)


def test_the_outcome_in_words() -> None:
    film, log_file = Path("push/video.mp4"), Path("push/force.csv")
    outcome = CaptureOutcome(Path("push"), film, log_file, "it was stopped", False, STATE, ("it is short",))
    assert outcome_words(outcome).splitlines() == [
        "Recorded push: 12.3 s, 369 frames (2 more are missing), 6150 samples of the force. It ended: it was stopped.",
        "k(s) so far: ± 8.4 % (95 %, median).",
        "It is short.",
        "Look at it with: onebend check push   Learn from it with: onebend learn push",
    ]
