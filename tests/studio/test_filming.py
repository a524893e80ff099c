"""The room Record: what the page may ask for, the process that records, and what it leaves however it ends."""

from __future__ import annotations

import base64
import io
import json
import shlex
import shutil
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest
import typer
from PIL import Image
from starlette.testclient import TestClient

from onebend.errors import StudioError
from onebend.live.commands import record
from onebend.live.guidance import CaptureState
from onebend.live.recording_folder import FilmWriter
from onebend.options import expanded
from onebend.studio import requests
from onebend.studio.filming import MadeRecording, RecordingJobs
from onebend.studio.places import StudioFolder
from onebend.studio.recorder import QUALITY, WIDEST, capture_line, check_data, state_data, work
from onebend.studio.recordings import jpeg_in
from onebend.studio.requests import check_source, sources_data
from onebend.studio.words import Asked
from onebend.studio.worker import Studio
from tests.live.streamed import frames, log, toml
from tests.recording.filmed import HEIGHT, WIDTH
from tests.studio.conftest import done_here, own


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> StudioFolder:
    """A folder with a recording to play, one that is only begun, and links and a recording beside it."""
    root = tmp_path_factory.mktemp("filming")
    played, begun, out = root / "studio" / "played", root / "studio" / "begun", root / "secret"
    for folder in (played, begun, out):
        folder.mkdir(parents=True)
        (folder / "recording.toml").write_text(toml(), encoding="utf-8")
    film = FilmWriter(played / "video.mp4", (WIDTH, HEIGHT))
    for frame in frames():
        film.write(frame.luma, frame.time)
    film.close()
    rows = np.column_stack([log().time, log().force])
    np.savetxt(played / "force.csv", rows, "%.5f", ",", header="time_s,fx_N,fy_N", comments="")
    (root / "studio" / "link").symlink_to(out)
    return StudioFolder.of(root / "studio")


def asked(**more: Any) -> Asked:
    """What the page sends."""
    return Asked({"out": "new", "like": "played", "camera": "film:played", "force": "log:played", **more})


@pytest.mark.parametrize("name", ["..", "../secret", "/tmp/x", "link", "link/inner", "a/../../b", "", ".", "x\\y", 3])
def test_nothing_is_recorded_out_of_the_folder(places: StudioFolder, name: Any) -> None:
    with pytest.raises(StudioError):
        requests.record(places, asked(out=name))
    if name not in ("", "."):
        with pytest.raises(StudioError):
            requests.record(places, asked(like=name))


@pytest.mark.parametrize(
    "spec",
    [
        "film:../secret", "film:/etc", "film:link", "log:link/force.csv", "csv:/var/log/syslog", "csv:../x.csv",
        "/etc/passwd", "/dev/video0/../mem", "/dev/mem", "v4l2:/dev/mem", "serial:/etc/passwd", "serial:/dev/../etc/x",
        "av:/etc/passwd", "av:file:/etc/passwd", "av:played/video.mp4", "av:concat:a|b", "av:movie=/etc/x,format=lavfi",
        "av:/etc/passwd,format=v4l2", "av:http:x", "av:list.txt,format=concat",
    ],
)  # fmt: skip
def test_no_source_is_a_file_out_of_the_folder(places: StudioFolder, spec: str) -> None:
    for key in ("camera", "force"):
        with pytest.raises(StudioError):
            requests.record(places, asked(**{key: spec}))


@pytest.mark.parametrize("way", ["by its own words", "by a link", "by a link in a bag"])
@pytest.mark.parametrize("key", ["camera", "force"])
def test_no_recording_leads_a_source_out_of_the_folder(places: StudioFolder, key: str, way: str) -> None:
    kind, file = ("film", "video.mp4") if key == "camera" else ("log", "force.csv")
    secret, evil = places.root.parent / "secret" / file, places.root / "evil"
    shutil.rmtree(evil, ignore_errors=True)
    shutil.copytree(places.root / "played", evil)
    shutil.copy(evil / file, secret)
    (evil / file).unlink()
    if way == "by its own words":
        text = (evil / "recording.toml").read_text().replace(f'file = "{file}"', f'file = "../../secret/{file}"')
        (evil / "recording.toml").write_text(text)
    elif way == "by a link":
        (evil / file).symlink_to(secret)
    else:
        (evil / file).mkdir()
        (evil / file / "part.mcap").symlink_to(secret)
    for name in ("evil", "evil/recording.toml"):
        with pytest.raises(StudioError, match=rf"leads out of {places.root}"):
            requests.record(places, asked(**{key: f"{kind}:{name}"}))
    found = sources_data(places, Asked())
    assert "evil" not in found["films" if key == "camera" else "logs"]
    assert "played" in found["films"]
    shutil.rmtree(evil)


def test_no_table_of_the_beam_is_copied_from_outside(places: StudioFolder) -> None:
    evil = places.root / "evil"
    shutil.copytree(places.root / "played", evil)
    text = (evil / "recording.toml").read_text()
    (evil / "recording.toml").write_text(text.replace("[beam]", '[beam]\nmass_file = "mass.csv"', 1))
    (places.root.parent / "secret" / "mass.csv").write_text("s,mass_kg_m\n0,0.1\n1,0.1\n")
    (evil / "mass.csv").symlink_to(places.root.parent / "secret" / "mass.csv")
    with pytest.raises(StudioError, match=r"mass\.csv' leads out of"):
        requests.record(places, asked(like="evil"))
    shutil.rmtree(evil)


@pytest.mark.parametrize(
    "spec",
    [
        "/dev/video12,size=640x480", "film:played", "av:0,format=avfoundation", "av:video=A B,format=dshow",
        "av:/dev/video0,format=v4l2", "av:rtsp://10.0.0.2/live", "serial:/dev/serial/by-id/usb-1,columns=fx_N",
        "serial:COM3,columns=fx_N", "ati:192.168.1.1", "ur:robot", "csv:played/force.csv", "",
    ],
)  # fmt: skip
def test_cameras_and_sensors_are_taken(places: StudioFolder, spec: str) -> None:
    check_source(places, spec)


def test_what_is_missing_or_no_number_is_said(places: StudioFolder) -> None:
    for more, says in (
        ({"camera": ""}, "name a camera"), ({"camera": 5}, "as text"), ({"camera": "film:\x07"}, "as text"),
        ({"until_percent": 0}, "until_percent: a number"), ({"until_percent": "5"}, "a number"), ({"crf": 41}, "crf"),
        ({"longest_s": 0.5}, "longest_s"), ({"longest_s": True}, "longest_s"), ({"camera": "x" * 2000}, "as text"),
    ):  # fmt: skip
        with pytest.raises(StudioError, match=says):
            requests.record(places, asked(**more))


@pytest.mark.parametrize("name", ["a" * 300, "a/" + "\u00e9" * 128 + "/b"])
def test_a_name_that_no_folder_can_have_is_refused_in_words(places: StudioFolder, name: str) -> None:
    with pytest.raises(StudioError, match="too long a name: a folder's has at most 255 bytes"):
        requests.record(places, asked(out=name))
    assert requests.record(places, asked(out="a" * 255))["out"] == "a" * 255


def test_the_command_beside_is_one_of_the_commands(places: StudioFolder) -> None:
    every = {
        "until_percent": 5,
        "longest_s": 20,
        "crf": 14,
        "now": True,
        "no_learning": True,
        "fast": True,
        "overwrite": True,
    }
    words = shlex.split(requests.record(places, asked(out="my push", **every))["command"])
    assert words[:3] == ["onebend", "record", "my push"]
    alone = typer.Typer()
    alone.command()(expanded(record))
    known = {name for one in typer.main.get_command(alone).params for name in one.opts}
    assert {word for word in words if word.startswith("--")} <= known
    assert words[words.index("--until") + 1] == "5%"
    plain = requests.record(places, asked(like="", force=""))
    assert plain["command"] == "onebend record new --camera film:played"
    dashed = requests.record(places, asked(out="-x"))
    assert (dashed["out"], dashed["command"].split()[2]) == ("./-x", "./-x")


def test_the_sources_are_the_recorders(places: StudioFolder) -> None:
    found = sources_data(places, Asked())
    assert (found["films"], found["logs"], found["begun"]) == (["played"], ["played"], ["begun"])
    assert {"example", "says", "keys"} == set(found["cameras"][0])
    assert "log:REC" in [one["example"] for one in found["forces"]]


def test_what_is_recorded_is_told_with_pictures_tags_and_advice(
    places: StudioFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(places.root)
    monkeypatch.setattr("onebend.studio.worker.OFTEN", 0.0)
    said = done_here(work, requests.record(places, asked(fast=True, no_learning=True, out="told")))
    assert said[0]["length_m"] > 0.0
    states = [one["state"] for one in said if "state" in one]
    stages = [one["stages"][one["stage"]] for one in states]
    assert "push" in stages
    assert states == sorted(states, key=lambda one: one["stage"])  # which of them are told, the machine's load decides
    assert all("touch nothing" in one["advice"][0] for one in states if one["stages"][one["stage"]] == "first rest")
    pictures = [one for one in said if "picture" in one]
    assert len(pictures) > 3
    first = Image.open(io.BytesIO(base64.b64decode(pictures[0]["picture"])))
    assert first.size == (WIDTH, HEIGHT) == tuple(pictures[0]["state"]["size_px"])
    tag = next(one for one in states[-1]["tags"] if one["corners_px"])
    corners = np.array(tag["corners_px"])
    assert corners.shape == (4, 2)
    assert np.hypot(*(corners[1] - corners[0])) == pytest.approx(tag["side_px"], rel=0.2)
    assert said[-2]["outcome"]["begun"]
    assert states[-1]["frames"] == said[-2]["outcome"]["frames"]
    assert said[-1]["check"]["faults"] == []
    assert check_data(places.root)["faults"][0].endswith("fill it in.")


def test_the_last_state_is_told_and_a_studio_that_stands_still_holds_nothing_up() -> None:
    free, memory = threading.Event(), io.StringIO()

    class Stuck(io.StringIO):
        def write(self, data: str) -> int:
            free.wait(10.0)
            return memory.write(data)

    begun = time.monotonic()
    with Studio(Stuck(), io.BytesIO()).watching(capture_line) as watch:
        for seconds in range(50):
            watch(CaptureState("push", seconds=float(seconds)))
        assert time.monotonic() - begun < 1.0
        free.set()
    assert json.loads(memory.getvalue().splitlines()[-1])["state"]["seconds"] == 49.0


def test_a_large_picture_is_made_small() -> None:
    written = jpeg_in(Image.new("L", (2500, 1000)), WIDEST, QUALITY)
    image = Image.open(io.BytesIO(base64.b64decode(written)))
    assert image.width <= WIDEST
    assert image.width / image.height == pytest.approx(2.5, rel=0.01)
    assert state_data(CaptureState("exposure"))["size_px"] is None


def test_where_an_outline_is_not_seen_nothing_is_told() -> None:
    state, memory = CaptureState("push", outline=np.array([[1.04, 2.0], [np.nan, np.nan]])), io.StringIO()
    with Studio(memory, io.BytesIO()).watching(capture_line) as watch:
        watch(state)
    assert json.loads(memory.getvalue().splitlines()[-1])["state"]["outline_px"] == [[1.0, 2.0], [None, None]]


def test_the_newest_pictures_are_kept_and_slow_tabs_miss_states_alone() -> None:
    filming = RecordingJobs(lambda _: None)
    filmed = filming.job = MadeRecording({"out": "new", "command": ""})
    with pytest.raises(StudioError, match="no picture"):
        filming.picture(1)
    for i in range(20):
        filmed.hear({"state": {"stage": 0, "frames": 0}, "picture": base64.b64encode(b"%d" % i).decode()})
        assert filmed.passing
    assert filming.picture(20) == filming.picture(3) == b"19"
    assert filming.picture(15) == b"14"
    assert (filmed.phase, filmed.shown()["picture"]) == ("recording", 20)
    filmed.hear({"outcome": {"begun": True, "fault": False}})
    assert (filmed.phase, filmed.passing) == ("checking", False)
    filmed.hear({"check": {"rows": [], "remarks": [], "faults": []}})
    assert not filmed.passing
    assert filmed.shown()["check"] is not None


def test_the_routes_say_what_there_is(client: TestClient) -> None:
    assert client.get("/api/record").json() == {"recording": None}
    assert "no picture" in client.get("/api/record/picture?n=1").json()["error"]
    for what in ("begin", "stop"):
        assert client.post(f"/api/record/{what}", json={}, headers=own()).status_code == 200
    assert client.post("/api/record/burn", json={}, headers=own()).status_code == 422
    refused = client.post("/api/record/start", json={"out": "../x", "camera": "film:x"}, headers=own())
    assert refused.status_code == 422
    assert "no name in this folder" in refused.json()["error"]


def test_the_first_picture_does_without_the_recorder() -> None:
    """Cameras, films and mechanics are loaded when the page is there."""
    call = "import sys, onebend.studio.server; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", call], capture_output=True, text=True, check=True)
    found = {name for name in done.stdout.split() if name.partition(".")[0] in ("onebend", "av", "scipy", "PIL")}
    assert {name.split(".")[1] for name in found if name.startswith("onebend.")} <= {
        "crash", "errors", "files", "progress", "studio", "text_files", "wings",
    }  # fmt: skip
    assert not found & {"av", "scipy", "PIL"}
