"""The program under attack: a process that has it loaded and lends itself, forked, to one command line after the other.

A fork costs milliseconds, an import half a second; and what crashes, hangs or fills the memory is only a fork.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import onebend

LIMIT_MB = 4096.0  # of address space: beyond it the attack has filled the memory
LIMIT_S = 300.0  # after which it hangs: a machine that is busy takes several times as long as a free one


@dataclass(frozen=True)
class Outcome:
    """How one command line ended."""

    code: int  # exit code; -9 where it was killed for the time it took
    out: str
    err: str
    work_s: float  # of the processor
    peak_MB: float  # noqa: N815  (the unit's own letters)

    @property
    def verdict(self) -> str:
        """ "refused" with one message, "done", or what must never be: "hang", "traceback", "crash"."""
        if self.code == -signal.SIGKILL:
            return "hang"
        if "Traceback" in self.err or "Traceback" in self.out:
            return "traceback"
        if self.code == 0:
            return "done"
        return "refused" if self.code == 2 and self.err.strip() else "crash"


class Victim:
    """`onebend`, attacked command line by command line."""

    def __init__(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.attack.victim"],
            cwd=Path(__file__).parents[2],
            env={**os.environ, "PYTHONPATH": str(Path(onebend.__file__).parents[1])},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def attack(
        self, arguments: Sequence[object], folder: Path, *, seconds: float = LIMIT_S, most_MB: float = LIMIT_MB
    ) -> Outcome:
        """Run `onebend ARGUMENTS` in `folder`, at most `seconds` long and within `most_MB` of address space."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        request = [[str(one) for one in arguments], str(folder), seconds, most_MB]
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        return Outcome(**json.loads(self.process.stdout.readline()))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.wait()
        self.process.stdout.close()


def serve() -> None:
    """Fork for every request that stands on standard input."""
    import onebend.cli
    import onebend.cli.learning
    import onebend.cli.recordings
    import onebend.report.figures  # noqa: F401  (loaded once, for every fork)

    for line in sys.stdin:
        arguments, folder, seconds, most_MB = json.loads(line)
        answer = os.dup(1)
        said = [Path(folder) / f".said-{name}" for name in ("out", "err")]
        child = os.fork()
        if child == 0:
            _be_attacked(arguments, folder, most_MB, said)
        status, usage = _waited(child, time.monotonic() + seconds)
        texts = [file.read_bytes().decode("utf-8", "replace") if file.exists() else "" for file in said]
        for file in said:
            file.unlink(missing_ok=True)
        work = usage.ru_utime + usage.ru_stime
        code = os.waitstatus_to_exitcode(status)
        result = Outcome(code, texts[0], texts[1], work, usage.ru_maxrss / 1024.0)
        os.write(answer, (json.dumps(vars(result)) + "\n").encode())
        os.close(answer)


def _waited(child: int, until: float) -> tuple[int, resource.struct_rusage]:
    while True:
        done, status, usage = os.wait4(child, os.WNOHANG)
        if done:
            return status, usage
        if time.monotonic() > until:
            os.kill(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
            return status, usage
        time.sleep(0.005)


def _be_attacked(arguments: list[str], folder: str, most_MB: float, said: list[Path]) -> None:
    """The rest of a forked process's life."""
    os.chdir(folder)
    for target, file in zip((1, 2), said, strict=True):
        os.dup2(os.open(file, os.O_CREAT | os.O_WRONLY | os.O_TRUNC), target)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    resource.setrlimit(resource.RLIMIT_AS, (int(most_MB * 2**20), int(most_MB * 2**20)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sys.argv = ["onebend", *arguments]
    code = 1
    try:
        import onebend.cli

        onebend.cli.main()
    except SystemExit as left:
        code = left.code if isinstance(left.code, int) else 0 if left.code is None else 1
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    serve()
