"""Processes and threads that share work: how many run at once here, and who answers to an interrupt."""

from __future__ import annotations

import os
import signal


def available_cores() -> int:
    """Cores that this process may use, 1 at least."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def leave_interrupts_to_parent() -> None:
    """Initialiser of a worker process: an interrupt is its parent's business, which ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
