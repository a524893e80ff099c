"""The other end of a wire: a module of these tests in a process of its own, asked in lines of JSON."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from onebend.live.sources import HostClock

Ask = Callable[..., Any]
LONGEST = 20.0  # s that an answer over the loopback may take


@contextmanager
def other_end(module: str, *words: str) -> Iterator[Ask]:
    """Start it, and give what asks it."""
    line = [sys.executable, "-m", module, *words]
    with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        stdin, stdout = process.stdin, process.stdout

        def ask(**what: Any) -> Any:
            stdin.write(f"{json.dumps(what)}\n")
            stdin.flush()
            return json.loads(stdout.readline())

        assert json.loads(stdout.readline())["ready"]
        yield ask
        stdin.close()
        process.wait(LONGEST)


def answer_lines(answer: Callable[[dict[str, Any]], Any]) -> None:
    """That end's own loop: a line when it is there, and one for each line that comes."""
    sys.stdout.write('{"ready": true}\n')
    sys.stdout.flush()
    for line in sys.stdin:
        sys.stdout.write(f"{json.dumps(answer(json.loads(line)))}\n")
        sys.stdout.flush()


def wait_for(look: Callable[[], Any], what: str = "it") -> Any:
    """What `look` gives, as soon as it gives something."""
    clock = HostClock()
    until = clock.now() + LONGEST
    while not (found := look()):
        assert clock.now() < until, f"{what} did not come in {LONGEST:.0f} s"
        clock.wait_until(clock.now() + 0.01)
    return found
