"""TOML, CSV and JSON of any content: one message each, soon, and within little memory."""

from __future__ import annotations

import os
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from onebend.results.model import save_model
from tests.attack.family import Case, Harm, edit, params, rewrite, sparse, withstood
from tests.attack.victim import Victim
from tests.made_up import BEAM

TOML, FORCE, MARKERS = "recording.toml", "force.csv", "markers.csv"
GIB = 2**30


def append(file: str, text: str) -> Harm:
    return partial(_append, file=file, text=text)


def _append(folder: Path, *, file: str, text: str) -> None:
    with (folder / file).open("a", encoding="utf-8") as stream:
        stream.write(text)


def cell(file: str, value: str, column: int = 1, row: int = 40) -> Harm:
    """One cell of a table replaced."""

    def change(text: str) -> str:
        lines = text.splitlines()
        cells = lines[row].split(",")
        cells[column] = value
        lines[row] = ",".join(cells)
        return "\n".join(lines) + "\n"

    return rewrite(file, change)


def times(file: str, new: str) -> Harm:
    """A last row at another time."""
    return rewrite(file, lambda text: f"{text}{new},{text.splitlines()[-1].split(',', 1)[1]}\n")


def named(table: str, key: str, target: str) -> Harm:
    """A key of a table that names a file."""
    return rewrite(TOML, lambda text: text.replace(f"[{table}]\n", f'[{table}]\n{key} = "{target}"\n'))


def special(kind: str) -> Harm:
    """The force log as a fifo, a device, or a link in a circle."""

    def harm(folder: Path) -> None:
        (folder / FORCE).unlink()
        if kind == "fifo":
            os.mkfifo(folder / FORCE)
        else:
            (folder / FORCE).symlink_to(FORCE if kind == "loop" else kind)

    return harm


NINES = "9" * 400
TOML_CASES = [
    Case("nested arrays", append(TOML, "\nx = " + "[" * 50_000 + "]" * 50_000), "nested too deeply"),
    Case("nested tables", append(TOML, "\nx = " + "{a=" * 5000 + "1" + "}" * 5000), "nested too deeply"),
    Case("a key of many parts", append(TOML, "\n" + ".".join("a" * 50_000) + " = 1"), "a key of more than 20 parts"),
    Case("quoted key of many parts", append(TOML, "\n" + ".".join(['"\\"."'] * 9000) + " = 1"), "more than 20 parts"),
    Case("many tables", append(TOML, "".join(f"\n[x{i}]" for i in range(20_000))), "19980 more mistakes"),
    Case("many keys", append(TOML, "".join(f"\nkey{i} = 1" for i in range(10_000))), "more mistakes"),
    Case("longer than a description", append(TOML, "\n# " + "x" * 2**19), "at most 262 kB are read"),
    Case("length of 400 digits", edit(TOML, "length_m = 0.15", f"length_m = {NINES}"), "length_m must be a number"),
    Case("id of 400 digits", edit(TOML, "id = 1\n", f"id = {NINES}\n"), "whole number of at least 0"),
    Case("id of 5000 digits", edit(TOML, "id = 1\n", f"id = {'9' * 5000}\n"), "more digits than any number"),
    Case("hexadecimal id", edit(TOML, "id = 1\n", f"id = 0x{'f' * 9000}\n"), "whole number|more digits"),
    Case("format of 400 digits", edit(TOML, "format = 1", f"format = {NINES}"), "format must be 1"),
    Case("a length in millimetres", edit(TOML, "length_m = 0.15", "length_m = 150.0"), "above 0 and at most 50"),
    Case("a length of nothing", edit(TOML, "length_m = 0.15", "length_m = 1e-320"), "length_m must be a number above"),
    Case("a length that is not a number", edit(TOML, "length_m = 0.15", "length_m = nan"), "length_m must be a number"),
    Case("a start beyond all times", edit(TOML, "start_s = 249.4", "start_s = 1e308"), "start_s must be a number"),
    Case(
        "an endless doubt",
        edit(TOML, "start_s = 249.4", "start_s = 249.4\nstart_uncertainty_s = 1e12"),
        "between 0 and",
    ),
    Case("a sd of nothing", edit(TOML, "placement_sd_m = 0.0005", "placement_sd_m = 1e-320"), passes=True),
    Case("UTF-16", rewrite(TOML, lambda text: text.encode("utf-16")), "is UTF-16. Save it as UTF-8"),
    Case("UTF-16 without mark", rewrite(TOML, lambda text: text.encode("utf-16-le")), "UTF-16"),
    Case(
        "Latin-1", rewrite(TOML, lambda text: f'name = "Bj\xf6rn"\n{text}'.encode("latin-1")), "line 1, it is not UTF-8"
    ),
    Case("byte order mark", rewrite(TOML, lambda text: text.encode("utf-8-sig")), passes=True),
    Case("zero bytes", edit(TOML, "0.15", "0.15\0"), "not valid TOML"),
    Case("empty", rewrite(TOML, lambda _: ""), "is empty"),
    Case("noise", rewrite(TOML, lambda _: np.random.default_rng(0).bytes(4000)), "not UTF-8|UTF-16"),
    Case("a name of 5 kB", rewrite(TOML, lambda text: f'name = "{"x" * 5000}"\n{text}'), "at most 100 characters"),
    Case("a long family", edit(TOML, "[tags]\n", f'[tags]\nfamily = "{"tag36h" * 9000}"\n'), "family must be one of"),
    Case("a long file name", edit(TOML, '"markers.csv"', f'"{"m" * 900}"'), "."),
    Case("a zero byte in a file name", edit(TOML, '"markers.csv"', '"m\\u0000.csv"'), "there is no file"),
    Case("an escape sequence as key", append(TOML, '\n"\\u001b[31mred" = 1\n'), r"does not know the key \\x1b"),
    Case(
        "tags by the hundred", append(TOML, "".join(f"\n[[tags.on_beam]]\nid={i}\ns=0.5" for i in range(9, 300))), "100"
    ),
    Case(
        "tables that are numbers",
        rewrite(TOML, lambda _: "format=1\nbeam=1\ntags=2\nmarkers=3\n"),
        "must be a table",
    ),
    Case("sparse description", sparse(TOML, 8 * GIB), "at most 262 kB are read"),
]
CSV_CASES = [
    case
    for file, word in ((FORCE, "force"), (MARKERS, "markers"))
    for case in (
        Case(f"{word}: a cell of 140 kB", cell(file, "9" * 140_000), "a line of more than"),
        Case(f"{word}: a cell of 90 kB", cell(file, "x" * 90_000), r"x\.\.\.,? not a number"),
        Case(f"{word}: a quote left open", cell(file, '"1'), "not closed in its line"),
        Case(f"{word}: a time of 1e300", cell(file, "1e300", column=0), "1e\\+300, more than|no time"),
        Case(f"{word}: a last time of 1e12", times(file, "1e12"), "more than 1e\\+11|no time"),
        Case(f"{word}: a last time of 1e6", times(file, "1e6"), "Correct the wrong times"),
        Case(f"{word}: escape sequences", cell(file, "\x1b[31m1"), r"x1b\[31m1', not a number"),
        Case(f"{word}: zero bytes", cell(file, "1\0"), "bytes that are no text"),
        Case(f"{word}: UTF-16", rewrite(file, lambda text: text.encode("utf-16")), "UTF-16"),
        Case(f"{word}: UTF-16 without mark", rewrite(file, lambda text: text.encode("utf-16-le")), "UTF-16"),
        Case(f"{word}: Latin-1", rewrite(file, lambda text: f"{text}# \xe4".encode("latin-1")), "not UTF-8"),
        Case(f"{word}: byte order mark", rewrite(file, lambda text: text.encode("utf-8-sig")), passes=True),
        Case(f"{word}: noise", rewrite(file, lambda _: np.random.default_rng(0).bytes(99_999)), "text"),
        Case(f"{word}: empty", rewrite(file, lambda _: ""), "is empty"),
        Case(f"{word}: a header alone", rewrite(file, lambda text: text.splitlines()[0]), "."),
        Case(f"{word}: many columns", rewrite(file, lambda _: ",".join(f"c{i}" for i in range(9000))), "at most 1000"),
        Case(f"{word}: one long line", rewrite(file, lambda _: "1," * 3_000_000), "a line of more than"),
        Case(f"{word}: a column twice", rewrite(file, lambda text: text.replace("\n", ",time_s\n", 1)), "there twice"),
        Case(f"{word}: sparse, 8 GB", sparse(file, 8 * GIB), "at most 1.07 GB are read"),
        Case(f"{word}: sparse, 300 MB", sparse(file, 300 * 2**20), "bytes that are no text|a line of more than"),
    )
]
SECRET = "root:|daemon"
FILE_CASES = [
    Case("force = /etc/passwd", edit(TOML, '"force.csv"', '"/etc/passwd"'), "no column"),
    Case("markers = /etc/passwd", edit(TOML, '"markers.csv"', '"/etc/passwd"'), "no column"),
    Case("a link to /etc/passwd", special("/etc/passwd"), "no column"),
    Case("mass_file = /etc/passwd", named("beam", "mass_file", "/etc/passwd"), "no column"),
    Case("section_file = /etc/passwd", named("beam", "section_file", "/etc/passwd"), "no column"),
    Case("force = /proc/kmsg", edit(TOML, '"force.csv"', '"/proc/kmsg"'), "is empty"),
    Case("force = /proc/self/mem", edit(TOML, '"force.csv"', '"/proc/self/mem"'), "is empty"),
    Case("force = /dev/zero", edit(TOML, '"force.csv"', '"/dev/zero"'), "is a device, and no file"),
    Case("force is a fifo", special("fifo"), "is a pipe, and no file"),
    Case("force is a circle of links", special("loop"), "is a link that leads nowhere"),
]
QUICK = {
    "nested arrays", "a key of many parts", "length of 400 digits", "id of 5000 digits", "UTF-16", "Latin-1",
    "an escape sequence as key", "tags by the hundred", "force: a cell of 140 kB", "markers: a cell of 90 kB",
    "force: a last time of 1e6", "force: sparse, 8 GB", "markers: UTF-16 without mark", "byte order mark",
    "force = /etc/passwd", "a link to /etc/passwd", "force is a fifo",
}  # fmt: skip


@pytest.mark.parametrize("case", params([*TOML_CASES, *CSV_CASES, *FILE_CASES], QUICK))
def test_a_recordings_text(victim: Victim, tracks: Path, case: Case) -> None:
    case.harm(tracks)
    outcome = victim.attack(["check", "rec"], tracks.parent)
    withstood(outcome, case)
    assert "root:" not in outcome.err + outcome.out


MODEL_CASES = [
    Case("nested", lambda file: file.write_text("[" * 100_000 + "]" * 100_000), "nested too deeply"),
    Case("NaN", lambda file: file.write_text('{"format": NaN}'), "NaN, which is no number"),
    Case("a number of 5000 digits", lambda file: file.write_text(f'{{"version": {"9" * 5000}}}'), "more digits"),
    Case("UTF-16", lambda file: file.write_bytes(file.read_text().encode("utf-16")), "UTF-16"),
    Case("Latin-1", lambda file: file.write_bytes(b'{"\xe4": 1}'), "not UTF-8"),
    Case("byte order mark", lambda file: file.write_bytes(file.read_text().encode("utf-8-sig")), passes=True),
    Case("empty", lambda file: file.write_text(""), "is empty"),
    Case("a list", lambda file: file.write_text("[1]"), "not an object"),
    Case("cut short", lambda file: file.write_text(file.read_text()[:200]), "not valid JSON"),
    Case("sparse", lambda file: os.truncate(file, 8 * GIB), "at most 67.1 MB are read"),
]


@pytest.mark.parametrize("case", params(MODEL_CASES, {"nested", "NaN", "byte order mark"}))
def test_a_model(victim: Victim, tmp_path: Path, case: Case) -> None:
    save_model(tmp_path / "model.json", BEAM, written_by="a test")
    case.harm(tmp_path / "model.json")
    withstood(victim.attack(["show", "model.json"], tmp_path), case)


GOALS = "s,x_m,y_m\n0.5,0.07,0.01\n1,0.14,0.03\n"
GOAL_CASES = [
    Case("a cell of 140 kB", lambda file: file.write_text(f"{GOALS}{'9' * 140_000},1,1\n"), "a line of more than"),
    Case("UTF-16", lambda file: file.write_bytes(GOALS.encode("utf-16")), "UTF-16"),
    Case("another file", lambda file: shutil.copy("/etc/passwd", file), "line 1: column"),
    Case(
        "sparse",
        lambda file: file.write_text(GOALS) and sparse(file.name, 8 * GIB)(file.parent),
        "at most 1.07 GB are read",
    ),
]


@pytest.mark.parametrize("case", params(GOAL_CASES, ()))
def test_targets(victim: Victim, tmp_path: Path, case: Case) -> None:
    save_model(tmp_path / "model.json", BEAM, written_by="a test")
    case.harm(tmp_path / "targets")
    outcome = victim.attack(["shape", "model.json", "--targets", "targets"], tmp_path)
    withstood(outcome, case)
    assert "root:" not in outcome.err


DESIGN_CASES = [
    Case("nested", lambda file: file.write_text("x = " + "[" * 9000 + "]" * 9000), "nested too deeply"),
    Case("UTF-16", lambda file: file.write_bytes("format = 1".encode("utf-16")), "UTF-16"),
    Case("digits", lambda file: file.write_text(f"format = {'9' * 5000}"), "more digits"),
]


@pytest.mark.parametrize("case", params(DESIGN_CASES, ()))
def test_a_design(victim: Victim, tmp_path: Path, case: Case) -> None:
    case.harm(tmp_path / "mine.toml")
    withstood(victim.attack(["design", "mine.toml"], tmp_path), case)
