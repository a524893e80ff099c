"""What README and docs show of the commands, made again: `python -m benchmarks.shown [NAME ...]`.

A screen stands in its page between `<!-- shown: NAME -->` and `<!-- end of NAME -->`. `docs/shown.json` keeps
two checksums of the source files behind each: of those that word or draw it, and of those that its numbers come
from. `--list` says which are older than their sources; `tests/whole/test_shown.py` does so too.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
STAMPS = ROOT / "docs" / "shown.json"
SOURCE = "src/onebend/"
DEMO = ["learn", "examples/linear-beam/train", "--output", "out/linear-beam", "--validate", "examples/linear-beam/fast"]
OF_A_RUN = ("cli/screens.py", "report/verdict.py", "report/sentences.py")
LEARNING = ("beam", "recording", "learning")


@dataclass(frozen=True)
class Shown:
    """One screen or picture; source files and folders are below `src/onebend`."""

    page: str  # whose block is replaced; empty: none
    command: tuple[str, ...]  # of onebend, or a script
    words: tuple[str, ...]  # what words or draws it
    numbers: tuple[str, ...]  # what its numbers come from
    pictures: tuple[tuple[str, str], ...] = ()  # made where, kept where


SHOWN = {
    "demo": Shown("docs/first-beam.md", (*DEMO, "--force"), OF_A_RUN, LEARNING),
    "plan": Shown("docs/plan.md", ("plan", "out/linear-beam"), ("cli/learning.py", "learning/design.py"), LEARNING),
    "learned": Shown("", ("examples/readme_picture.py",), ("report/figures.py", "report/style.py"), LEARNING),
}


def checksum(files: Iterable[Path]) -> str:
    """Of what they say: blank lines, and lines that are comments, apart."""
    whole = hashlib.sha256()
    for path in sorted(files):
        lines = (line.rstrip() for line in path.read_text(encoding="utf-8").splitlines())
        kept = [line for line in lines if line and not line.lstrip().startswith("#")]
        whole.update("\n".join([path.relative_to(ROOT).as_posix(), *kept]).encode())
    return whole.hexdigest()[:16]


def sources(names: Iterable[str]) -> list[Path]:
    """The Python files of files and folders below `src/onebend`."""
    places = [ROOT / SOURCE / name for name in names]
    return [file for place in places for file in (place.rglob("*.py") if place.is_dir() else [place])]


def stamp_of(one: Shown) -> dict[str, str]:
    """The checksums as the sources are now."""
    return {"words": checksum(sources(one.words)), "numbers": checksum(sources(one.numbers))}


def older(part: str) -> list[str]:
    """Names whose `part` ("words" or "numbers") comes from other sources than those of now."""
    kept = json.loads(STAMPS.read_text(encoding="utf-8"))
    return [name for name, one in SHOWN.items() if kept.get(name, {}).get(part) != stamp_of(one)[part]]


def put_block(text: str, begin: str, end: str, block: str) -> str:
    """The page `text` with `block` between `begin` and `end`; raises `ValueError` where these do not stand in it."""
    before, found, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"the page has no {begin.strip()} ... {end}")
    return f"{before}{begin}{block}{end}{after}"


def put_in(text: str, name: str, screen: str) -> str:
    """The page `text` with a new screen, four spaces in; raises `ValueError` where it has no place for it."""
    lines = "\n".join(f"    {line}".rstrip() for line in screen.strip("\n").splitlines())
    return put_block(text, f"<!-- shown: {name} -->\n", f"<!-- end of {name} -->", f"\n{lines}\n\n")


def printed(command: tuple[str, ...]) -> str:
    """What it prints, on a screen of 80 columns."""
    what = [sys.executable, *command] if command[0].endswith(".py") else [sys.executable, "-m", "onebend", *command]
    given = {**os.environ, "COLUMNS": "80", "LINES": "25", "NO_COLOR": "1"}
    return subprocess.run(what, cwd=ROOT, env=given, stdout=subprocess.PIPE, text=True, check=True).stdout


def renew(name: str, run: Callable[[tuple[str, ...]], str] = printed) -> None:
    """Make it again, and keep the checksums of the sources that it was made by."""
    one = SHOWN[name]
    stamp, screen = stamp_of(one), run(one.command)
    if one.page:
        page = ROOT / one.page
        page.write_text(put_in(page.read_text(encoding="utf-8"), name, screen), encoding="utf-8")
    for made, kept in one.pictures:
        shutil.copyfile(ROOT / made, ROOT / kept)
    kept_stamps = json.loads(STAMPS.read_text(encoding="utf-8")) if STAMPS.is_file() else {}
    STAMPS.write_text(json.dumps(kept_stamps | {name: stamp}, indent=2, sort_keys=True) + "\n", encoding="utf-8")


def _from_the_command_line() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", choices=[[], *SHOWN], help="default: all")
    parser.add_argument("--list", action="store_true", help="say what is older than its sources, and make nothing")
    given = parser.parse_args()
    if given.list:
        for part in ("words", "numbers"):
            print(f"{part} of older sources: {', '.join(older(part)) or 'none'}")
        return
    for name in given.names or SHOWN:
        print(name, flush=True)
        renew(name)


if __name__ == "__main__":
    _from_the_command_line()
