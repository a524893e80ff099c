"""Record: the recording that goes on, or the last one."""

from __future__ import annotations

import base64
from dataclasses import dataclass, field
from typing import Any

from onebend.errors import StudioError
from onebend.studio.jobs import Job, Jobs, ended

_KEPT = 8  # pictures
_GOING = ("starting", "recording", "stopping", "checking")


@dataclass
class MadeRecording(Job):
    """A recording in progress, or the last one."""

    length_m: float = 0.0
    phase: str = "starting"  # recording, stopping, checking, done, failed
    known: dict[str, Any] = field(default_factory=dict)  # from `recorder.state_data`
    curve: dict[str, Any] | None = None  # k(s) so far
    pictures: dict[int, bytes] = field(default_factory=dict)  # the newest, by number
    outcome: dict[str, Any] | None = None
    check: dict[str, Any] | None = None
    passing: bool = False

    @property
    def goes_on(self) -> bool:
        return self.phase in _GOING

    @property
    def busy(self) -> str:
        return f"{self.wanted['out']} is being recorded. Stop it, or wait"

    def shown(self) -> dict[str, Any]:
        own = {name: getattr(self, name) for name in ("length_m", "phase", "curve", "outcome", "check", "error")}
        now = {"state": self.known, "picture": max(self.pictures, default=0)}
        return {"out": self.wanted["out"], "command": self.wanted["command"], **own, **now}

    def hear(self, said: dict[str, Any]) -> None:
        if "picture" in said:
            self.pictures[max(self.pictures, default=0) + 1] = base64.b64decode(said["picture"])
            for number in sorted(self.pictures)[:-_KEPT]:
                del self.pictures[number]
        self.passing, self.known = "state" in said, said.get("state", self.known)
        for name in {"length_m", "curve", "outcome", "check", "error"} & set(said):
            setattr(self, name, said[name])
        if self.passing and self.phase == "starting":
            self.phase = "recording"
        elif "outcome" in said and said["outcome"]["begun"]:
            self.phase = "checking"

    def end(self, code: int) -> None:
        self.passing = False
        if self.goes_on:
            failed = self.outcome is None or bool(self.outcome["fault"]) or not self.outcome["begun"]
            self.phase = "failed" if failed else "done"
        if self.outcome is None and not self.error:
            kept = f"The recording up to then is in {self.wanted['out']}" if self.known.get("frames") else "Try again"
            self.error = f"the recorder ended with {code}. {kept}"


class RecordingJobs(Jobs):
    """At most one recording at a time."""

    kind = MadeRecording
    patience = 20.0  # s for a stopped recorder to write everything
    words = ("begin",)  # the film, despite a poor picture

    @property
    def made(self) -> MadeRecording | None:
        return self.job if isinstance(self.job, MadeRecording) else None

    def picture(self, number: int) -> bytes:
        """A JPEG, or the newest. Raises `StudioError` before the first."""
        if self.made is None or not self.made.pictures:
            raise StudioError("no picture came yet")
        return self.made.pictures.get(number) or self.made.pictures[max(self.made.pictures)]

    async def stop(self) -> None:
        """Ends the film and keeps it."""
        if self.made is not None and self.made.phase in ("starting", "recording"):
            self.made.phase = "stopping"
            self.say("stop")
            self.changed(False)

    async def end(self) -> None:
        """Ends the film and waits until all is on disk; kills a recorder that does not end."""
        process = self._process
        if process is not None and process.returncode is None and process.stdin is not None:
            process.stdin.close()
            await ended(process, self.patience)
