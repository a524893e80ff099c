"""End a process that publishes results at every point, and look at what it left. Run as a script: it forks.

    python killing.py FOLDER SCENARIO EVERY HOW

At each point a child process begins to publish and meets its end before it touches the disk once more (HOW is `killed`
by SIGKILL, or `full`: the disk is, once) or before it executes the next line of `onebend.files` (`killed-lines`, or
`interrupted-lines` by Ctrl-C). Then the folder must hold the old results or the new ones, whole, or files of both that
its summary tells apart, and all that is not ours; and the next run must bring everything to rest. What was found goes
to standard output as JSON.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

from onebend.errors import ResultsError
from onebend.files.publish import abandon, changed_files, finish, prepare, publish, read_summary, write_summary

KIND = "onebend-test-1"
TOUCHES = (
    "os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.chmod", "os.utime", "shutil.rmtree",
)  # fmt: skip
SCENARIOS = ("fresh", "empty", "earlier", "others", "twice")


def write(folder: Path, mark: str) -> None:
    """Three files that all say which run wrote them, and the summary."""
    for name in ("model.json", "stiffness.csv", "figures/k.png"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(mark)
    (folder / f"only-{mark}.txt").write_text(mark)
    write_summary(folder, {"format": KIND, "mark": mark})


def run(out: Path, mark: str, *, twice: bool = False, overwrite: bool = True) -> None:
    """As the command line works."""
    place = prepare(out, kind=KIND, overwrite=overwrite)
    try:
        publish(place, partial(write, mark=mark))
        if twice:
            publish(place, partial(write, mark=f"{mark}-again"))
    except BaseException:
        abandon(place)
        raise
    finish(place)


def others_in(out: Path) -> dict[str, object]:
    """What is not ours in the scenario `others`, as it is now."""
    return {
        "notes": (out / "notes.txt").read_text(),
        "picture": (out / "figures" / "mine.png").read_text(),
        "deep": (out / "mine" / "deep" / "thesis.tex").read_text(),
        "empty": (out / "empty").is_dir() and not any((out / "empty").iterdir()),
        "link": str((out / "link").readlink()),
    }


def begin(root: Path, scenario: str) -> Path:
    """The folder before the run that is killed."""
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    out = root / "out"
    if scenario == "empty":
        out.mkdir()
    elif scenario != "fresh":
        run(out, "old")
    if scenario == "others":
        (out / "notes.txt").write_text("mine")
        (out / "figures" / "mine.png").write_text("mine")
        (out / "mine" / "deep").mkdir(parents=True)
        (out / "mine" / "deep" / "thesis.tex").write_text("mine")
        (out / "empty").mkdir()
        (out / "link").symlink_to("nowhere")
    return out


def meet(how: str) -> None:
    """The end."""
    if how.startswith("killed"):
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "full":
        raise OSError(errno.ENOSPC, "No space left on device")
    raise KeyboardInterrupt


def end_at(point: int, how: str) -> Callable[[], bool]:
    """From now on, end the work before its `point`-th touch of the disk (or line). Returns whether that was reached."""
    seen = 0

    def one_more() -> None:
        nonlocal seen
        seen += 1
        if seen == point + 1:
            meet(how)

    def audit(event: str, arguments: tuple[Any, ...]) -> None:
        writes = event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
        if event in TOUCHES or writes:
            one_more()

    def trace(frame: FrameType, event: str, _: object) -> Any:
        if f"onebend{os.sep}files" not in frame.f_code.co_filename:
            return None
        if event == "line":
            one_more()
        return trace

    if how.endswith("lines"):
        sys.settrace(trace)
    else:
        sys.addaudithook(audit)
    return lambda: seen > point


def ended(out: Path, scenario: str, point: int, how: str) -> bool:
    """Publish in a child that meets its end at a point. False: it had finished before."""
    child = os.fork()
    if child == 0:
        reached = end_at(point, how)
        try:
            run(out, "new", twice=scenario == "twice")
        except (ResultsError, OSError, KeyboardInterrupt):
            pass
        except BaseException:
            os._exit(7)
        os._exit(0 if reached() else 5)
    _, status = os.waitpid(child, 0)
    if os.WIFEXITED(status) and os.WEXITSTATUS(status) == 7:
        raise AssertionError(f"the child failed at point {point}")
    return os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0


def state_of(out: Path) -> str:
    """`old`, `new`, ..., `absent` or `empty`; what else there may be is a fault."""
    if not out.exists():
        return "absent"
    if not any(out.iterdir()):
        return "empty"
    summary = read_summary(out)
    if summary is None or changed_files(out):
        raise AssertionError(f"not whole: {sorted(path.name for path in out.iterdir())}")
    mark = str(summary["mark"])
    names = {"model.json", "stiffness.csv", "figures/k.png", f"only-{mark}.txt", "summary.json"}
    if set(summary["files"]) != names or any((out / name).read_text() != mark for name in names - {"summary.json"}):
        raise AssertionError(f"mixed: {sorted(summary['files'])}")
    if strangers := [path.name for path in out.glob("only-*") if path.name != f"only-{mark}.txt"]:
        raise AssertionError(f"of another run: {strangers}")
    return mark


def check(root: Path, out: Path, scenario: str) -> str:
    """What is there after the kill, and that the next run brings it to rest."""
    state = "moving" if any(root.glob(".out.onebend-*/moving")) else state_of(out)
    allowed = {"fresh": {"absent", "new", "moving"}, "empty": {"empty", "new", "moving"}}
    if state not in allowed.get(scenario, {"old", "new", "new-again", "moving"}):
        raise AssertionError(f"{state} is neither the old result nor the new one")
    if state == "moving" and scenario not in allowed and read_summary(out) is None:
        raise AssertionError("nothing tells which files are of which run")
    mine = scenario == "others"
    expected = {"notes": "mine", "picture": "mine", "deep": "mine", "empty": True, "link": "nowhere"}
    if mine and others_in(out) != expected:
        raise AssertionError("something of others is not there")
    run(out, "next")
    if state_of(out) != "next" or (mine and others_in(out) != expected):
        raise AssertionError("the next run did not bring it to rest")
    if [path.name for path in root.iterdir()] != ["out"]:
        raise AssertionError(f"left behind: {sorted(path.name for path in root.iterdir())}")
    return state


def main(folder: str, scenario: str, every: str, how: str) -> None:
    vars(os)["fsync"] = lambda _: None  # a killed process needs none, and it takes most of the time
    root, points, faults = Path(folder), 0, []
    seen: dict[str, int] = {}
    while True:
        out = begin(root, scenario)
        if not ended(out, scenario, points * int(every), how):
            break
        try:
            state = check(root, out, scenario)
            seen[state] = seen.get(state, 0) + 1
        except Exception as error:
            faults.append(f"point {points * int(every)}: {type(error).__name__}: {error}")
        points += 1
    sys.stdout.write(json.dumps({"points": points, "seen": seen, "faults": faults}))


if __name__ == "__main__":
    main(*sys.argv[1:])
