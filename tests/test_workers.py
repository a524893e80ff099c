"""What the processes that work ask of the system."""

from __future__ import annotations

import subprocess
import sys

import pytest

from onebend.workers import keep_freed_memory

FAULTS = """
import resource, sys
from onebend.workers import keep_freed_memory
if sys.argv[1] == "kept":
    assert keep_freed_memory()
def work():
    return sum(map(len, [bytes([i]) * 4_000_000 for i in range(1, 9)]))
work()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
work(), work(), work()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(way: str) -> int:
    """Pages that the system clears while eight times 4 MB are taken and left free, three times."""
    return int(subprocess.run([sys.executable, "-c", FAULTS, way], check=True, capture_output=True).stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's own allocator is asked")
def test_memory_left_free_is_taken_again() -> None:
    assert faults("kept") < 0.2 * faults("given back")


def test_other_systems_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    assert not keep_freed_memory()
