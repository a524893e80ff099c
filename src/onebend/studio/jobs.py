"""Long work in a separate process that can be stopped, and its progress: both ends."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import shlex
import signal
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TextIO

from onebend.errors import OnebendError, StudioError
from onebend.text_files import to_json

_PATIENCE = 8.0  # s to end after an interrupt
_LONGEST_LINE = 2**22  # bytes
_OFTEN = 0.1  # s between lines of one stage


@dataclass
class Job:
    wanted: dict[str, Any]
    began: float = field(default_factory=time.time)
    stages: list[dict[str, Any]] = field(default_factory=list)  # by start
    state: str = "running"  # running, stopping, done, stopped, failed
    error: str = ""
    published: bool = False  # k(s) is in place; the report may still be drawn
    found: list[dict[str, Any]] = field(default_factory=list)  # results so far
    now: dict[str, Any] | None = None  # what is known now, of work that goes with the clock
    ended: float | None = None

    @property
    def goes_on(self) -> bool:
        return self.state in ("running", "stopping")

    @property
    def busy(self) -> str:
        """Why another cannot begin."""
        return f"another runs: {self.wanted['command']}. Stop it, or wait"

    def shown(self) -> dict[str, Any]:
        return {
            **{name: value for name, value in self.wanted.items() if name != "folder"},
            "began": self.began,
            "seconds": (self.ended or time.time()) - self.began,
            "stages": self.stages,
            "state": self.state,
            "error": self.error,
            "published": self.published,
            "found": len(self.found),
            "now": self.now,
        }

    def hear(self, said: dict[str, Any]) -> None:
        if "stage" in said:
            row = {name: said.get(name) for name in ("stage", "done", "total")}
            if self.stages and self.stages[-1]["stage"] == row["stage"]:
                self.stages[-1] = row
            else:
                self.stages.append(row)
        elif said.get("published") is True:
            self.published = True
        elif "found" in said:
            self.found.append(said["found"])
        elif "now" in said:
            self.now = said["now"]
        elif "error" in said:
            self.error = str(said["error"])

    def end(self, code: int) -> None:
        """The process ended."""
        self.ended = time.time()
        if code == 0:
            self.state = "done"
        elif self.state == "stopping" or code == 130:
            self.state = "stopped"
        else:
            self.state, self.error = "failed", self.error or f"the process ended with {code}"


class Jobs:
    """Work of one kind, one at a time."""

    kind: type[Job] = Job

    def __init__(self, module: str, changed: Callable[[], None], patience: float = _PATIENCE) -> None:
        """`module`: of this folder, run as a process, which has so much `patience` [s] to end after an interrupt."""
        self.module, self.changed, self._patience = module, changed, patience
        self.job: Job | None = None
        self._process: asyncio.subprocess.Process | None = None
        self._task: asyncio.Task[None] | None = None

    def shown(self) -> dict[str, Any] | None:
        """None before the first."""
        return None if self.job is None else self.job.shown()

    async def start(self, wanted: dict[str, Any]) -> None:
        """Raises `StudioError` while a job of this kind runs."""
        if self.job is not None and self.job.goes_on:
            raise StudioError(self.job.busy)
        self.job = self.kind(wanted)
        self._process = await begun(self.module)
        self.say(json.dumps(wanted))
        self._task = asyncio.create_task(self._follow(self.job, self._process))
        self.changed()

    def say(self, line: str) -> None:
        """To the process, if it is there."""
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(OSError, RuntimeError):  # already ended
                self._process.stdin.write(f"{line}\n".encode())

    async def stop(self) -> None:
        """Interrupts the job, and kills it if it does not end."""
        job, process = self.job, self._process
        if job is None or process is None or process.returncode is not None:
            return
        job.state = "stopping"
        self.changed()
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGINT)
        await ended(process, self._patience)
        if self._task is not None:
            await self._task

    async def _follow(self, job: Job, process: asyncio.subprocess.Process) -> None:
        async for said in lines_of(process):
            job.hear(said)
            self.changed()
        job.end(await process.wait())
        self.changed()


async def begun(module: str) -> asyncio.subprocess.Process:
    """A module of this folder as a process that communicates by lines."""
    return await asyncio.create_subprocess_exec(
        sys.executable,
        *("-m", f"onebend.studio.{module}"),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        limit=_LONGEST_LINE,
        start_new_session=True,  # ends when told to, not with the terminal
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )


async def lines_of(process: asyncio.subprocess.Process) -> AsyncIterator[dict[str, Any]]:
    """JSON objects, one per line; other lines are skipped."""
    assert process.stdout is not None
    async for line in process.stdout:
        with contextlib.suppress(ValueError):
            yield json.loads(line)


async def ended(process: asyncio.subprocess.Process, patience: float) -> None:
    """Waits; kills the process after `patience` [s]."""
    try:
        await asyncio.wait_for(process.wait(), patience)
    except TimeoutError:
        with contextlib.suppress(ProcessLookupError):
            process.kill()


def asked_number(asked: Mapping[str, Any], key: str, least: float, most: float, usual: float) -> float:
    """A number of the request, default `usual`. Raises `StudioError` if out of range."""
    found = asked.get(key, usual)
    if isinstance(found, bool) or not isinstance(found, int | float) or not least <= found <= most:
        raise StudioError(f"{key}: a number from {least:g} to {most:g}")
    return float(found)


class Lines:
    """A `Progress` that writes JSON lines."""

    def __init__(self) -> None:
        self._stack: list[list[Any]] = []  # stage, done, total
        self._said = 0.0

    def start(self, stage: str, total: int | None) -> None:
        self._stack.append([stage, 0, total])
        self._say()

    def advance(self, count: int = 1) -> None:
        self._stack[-1][1] += count
        if time.monotonic() - self._said > _OFTEN:
            self._say()

    def done(self) -> None:
        self._say()
        self._stack.pop()

    def _say(self) -> None:
        self._said = time.monotonic()
        stage, done, total = self._stack[-1]
        tell({"stage": stage, "done": done, "total": total})


def tell(data: Mapping[str, Any], out: TextIO | None = None) -> None:
    """A line on standard output or `out`; the reader may be gone."""
    stream = out or sys.stdout
    with contextlib.suppress(OSError, ValueError):
        stream.write(to_json(data, ascii_only=True, readable=False) + "\n")
        stream.flush()


def process(work: Callable[[Mapping[str, Any]], None], *, alone: bool = True) -> int:
    """Main function of a `Jobs` process: `work` on the JSON object on standard input, in the folder that it names. With
    `alone` it outlives the studio.

    Returns 0: done; 2: failed; 130: interrupted.
    """
    wanted = json.loads(sys.stdin.readline())
    if not alone:
        threading.Thread(target=_end_after, args=(os.getppid(),), daemon=True).start()
    os.chdir(wanted["folder"])
    sys.argv = shlex.split(wanted["command"])  # for provenance
    try:
        work(wanted)
    except OnebendError as error:
        tell({"error": str(error)})
        return 2
    except KeyboardInterrupt:
        tell({"error": "Stopped."})
        return 130
    tell({"finished": True})
    return 0


def _end_after(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(0)
