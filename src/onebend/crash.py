"""How errors end: a user's mistake in its message, what is unforeseen in one line, and a file with the rest.

Output that cannot be written (a full disk, a closed pipe) ends the program too; characters that the output's encoding
lacks are replaced.
"""

from __future__ import annotations

import errno
import os
import platform
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

from onebend.errors import OnebendError, reference

FAILED, INTERRUPTED = 2, 130
LONGEST = 300  # characters of an error's own words


@contextmanager
def clean_errors() -> Iterator[None]:
    """Ends a user's mistake in one message."""
    try:
        yield
    except OnebendError as error:
        _end(str(error), error, FAILED, docs=reference(error.about))
    except KeyboardInterrupt as error:
        _end("Interrupted.", error, INTERRUPTED)
    except BrokenPipeError:
        raise SystemExit(FAILED) from None
    except OSError as error:
        _end(f"{error.filename or 'the output'}: {error.strerror or error}", error, FAILED)


def _end(message: str, error: BaseException, code: int, *, docs: str = "") -> NoReturn:
    sentences = [message, *getattr(error, "__notes__", ())]
    text = " ".join(one if one.endswith((".", "?", "!")) else f"{one}." for one in sentences)
    tell("\n".join(filter(None, (text, docs))))
    raise SystemExit(code) from None


def guarded(work: Callable[[], object], version: str) -> NoReturn:
    """Do `work` and end the process: as it asks to, or with 2 and one line where something unforeseen ends it."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, ValueError, OSError):
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    try:
        with clean_errors():
            work()
        code: str | int | None = 0
    except SystemExit as asked:
        code = FAILED if asked.code == 1 else asked.code  # Typer's, where a pipe is closed
    except BaseException as error:
        code = FAILED
        tell(" ".join((words(error), *getattr(error, "__notes__", ()), kept(error, version))))
    sys.exit(code if _flushed() else FAILED)


def words(error: BaseException) -> str:
    """What happened, in a sentence."""
    if isinstance(error, MemoryError):
        return "there is not enough memory for this."
    try:
        said = str(error)[:LONGEST].replace("\n", "\\n")
    except Exception:
        said = ""
    return f"a fault of onebend's own ({type(error).__name__}{': ' if said else ''}{said})."


def kept(error: BaseException, version: str) -> str:
    """Write all that is known of the error to a file of its own; say which."""
    try:
        number, name = tempfile.mkstemp(prefix="onebend-crash-", suffix=".txt")
        with os.fdopen(number, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"onebend {version}, Python {platform.python_version()}, {platform.platform()}\n")
            file.write(f"command: {sys.argv!r}\n\n")
            file.write("".join(traceback.format_exception(error)))
    except BaseException:
        return "Nothing more could be written down."
    return f"Please report it with the file {name}, which says where."


def tell(text: str) -> None:
    """On standard error, where that can be written."""
    from onebend.text_files import printable  # here: what goes well does without

    with suppress(OSError, ValueError, AttributeError):
        sys.stderr.write(f"onebend: {printable(text)}\n")


def _flushed() -> bool:
    done = True
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None and not stream.closed:
                stream.flush()
        except (OSError, ValueError) as error:
            done = False
            if stream is sys.stdout and getattr(error, "errno", None) != errno.EPIPE:
                tell(f"the output cannot be written ({getattr(error, 'strerror', None) or error}).")
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    return done
