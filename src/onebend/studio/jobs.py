"""Long work in a process of its own, which can be stopped, and what it says of how far it is."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from onebend.errors import StudioError

_PATIENCE = 8.0  # s that a process has to end after an interrupt
_LONGEST_LINE = 2**20


@dataclass
class Job:
    """One learning that runs or ran."""

    wanted: dict[str, Any]
    began: float = field(default_factory=time.time)
    stages: list[dict[str, Any]] = field(default_factory=list)  # in the order in which they began
    state: str = "running"  # running, stopping, done, stopped, failed
    error: str = ""
    published: bool = False  # k(s) is in place; the report may still be drawn
    ended: float | None = None

    def shown(self) -> dict[str, Any]:
        """For the page."""
        return {
            "recordings": self.wanted["recordings"],
            "out": self.wanted["out"],
            "command": self.wanted["command"],
            "seconds": (self.ended or time.time()) - self.began,
            "stages": self.stages,
            "state": self.state,
            "error": self.error,
            "published": self.published,
        }

    def hear(self, said: dict[str, Any]) -> None:
        """One line of the process."""
        if "stage" in said:
            row = {name: said.get(name) for name in ("stage", "done", "total")}
            if self.stages and self.stages[-1]["stage"] == row["stage"]:
                self.stages[-1] = row
            else:
                self.stages.append(row)
        elif said.get("published") is True:
            self.published = True
        elif "error" in said:
            self.error = str(said["error"])


class Jobs:
    """At most one job at a time: two would only be slower."""

    def __init__(self, changed: Callable[[], None]) -> None:
        self.changed = changed
        self.job: Job | None = None
        self._process: asyncio.subprocess.Process | None = None
        self._task: asyncio.Task[None] | None = None

    async def start(self, wanted: dict[str, Any]) -> None:
        """Begin to learn. Raises `StudioError` while another job runs."""
        if self.job is not None and self.job.state in ("running", "stopping"):
            raise StudioError("another recording is being learned. Stop it, or wait")
        self.job = Job(wanted)
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = await asyncio.create_subprocess_exec(
            sys.executable,
            *("-m", "onebend.studio.learner"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
            limit=_LONGEST_LINE,
            start_new_session=True,  # it ends when it is told to, not when the terminal is
            env=environment,
        )
        assert self._process.stdin is not None
        self._process.stdin.write((json.dumps(wanted) + "\n").encode())
        self._process.stdin.close()
        self._task = asyncio.create_task(self._follow(self.job, self._process))
        self.changed()

    async def stop(self) -> None:
        """Interrupt the job; one that does not end is killed."""
        job, process = self.job, self._process
        if job is None or process is None or process.returncode is not None:
            return
        job.state = "stopping"
        self.changed()
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGINT)
        try:
            await asyncio.wait_for(process.wait(), _PATIENCE)
        except TimeoutError:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
        if self._task is not None:
            await self._task

    async def _follow(self, job: Job, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        async for line in process.stdout:
            with contextlib.suppress(ValueError):
                job.hear(json.loads(line))
            self.changed()
        code = await process.wait()
        job.ended = time.time()
        if code == 0:
            job.state = "done"
        elif job.state == "stopping" or code == 130:
            job.state = "stopped"
        else:
            job.state, job.error = "failed", job.error or f"the process ended with {code}"
        self.changed()
