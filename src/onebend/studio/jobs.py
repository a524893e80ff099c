"""Long work in a separate process (`onebend.studio.worker`) that can be stopped, and its progress."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from typing import Any

from onebend.errors import StudioError

_LONGEST_LINE = 2**22  # bytes


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
    passing = False  # what was heard last is soon replaced

    @property
    def goes_on(self) -> bool:
        return self.state in ("running", "stopping")

    @property
    def busy(self) -> str:
        """Why another cannot begin."""
        return f"another runs: {self.wanted['command']}. Stop it, or wait"

    def shown(self) -> dict[str, Any]:
        asked = {name: value for name, value in self.wanted.items() if name != "folder"}
        known = {name: getattr(self, name) for name in ("began", "stages", "state", "error", "published", "now")}
        return {**asked, **known, "seconds": (self.ended or time.time()) - self.began, "found": len(self.found)}

    def hear(self, said: dict[str, Any]) -> None:
        if "stage" in said:
            row = {name: said.get(name) for name in ("stage", "done", "total")}
            if self.stages and self.stages[-1]["stage"] == row["stage"]:
                self.stages[-1] = row
            else:
                self.stages.append(row)
        elif "found" in said:
            self.found.append(said["found"])
        for name in {"published", "now", "error"} & set(said):
            setattr(self, name, said[name])

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
    patience = 8.0  # s to end after an interrupt
    words: tuple[str, ...] = ()  # that may be said to it

    def __init__(self, changed: Callable[[bool], None]) -> None:
        """`changed`: told of every change, and whether there is something new in the folder."""
        self.changed = changed
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
        self._process = await begun()
        self.say(json.dumps(wanted))
        self._task = asyncio.create_task(self._follow(self.job, self._process))
        self.changed(False)

    async def do(self, what: str) -> None:
        """What a person asks for meanwhile: to stop, or one of the `words`. Raises `StudioError` for another."""
        if what == "stop":
            await self.stop()
        elif what in self.words:
            self.say(what)
        else:
            raise StudioError(f"work is started and stopped; there is no {what[:100]!r}")

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
        self.changed(False)
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGINT)
        await ended(process, self.patience)
        if self._task is not None:
            await self._task

    async def end(self) -> None:
        """The studio ends."""
        await self.stop()

    async def _follow(self, job: Job, process: asyncio.subprocess.Process) -> None:
        async for said in lines_of(process):
            before = job.published
            job.hear(said)
            self.changed(job.published and not before)
        job.end(await process.wait())
        self.changed(True)


class DriveJobs(Jobs):
    """A plan, and the drive when `go` is said."""

    patience = 60.0  # s for a robot to release the beam and come back
    words = ("go",)


async def begun() -> asyncio.subprocess.Process:
    """A process that communicates by lines."""
    return await asyncio.create_subprocess_exec(
        sys.executable,
        *("-m", "onebend.studio.worker"),
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
