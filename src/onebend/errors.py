"""The few named errors of onebend, and where docs/troubleshooting.md says more of errors and warnings.

Every message says what is wrong, where, and what to do. Every warning says what it is about, by a key of
`sections.toml`, whatever its words are, and so does an error that has a section of its own.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path


class OnebendError(Exception):
    """Base of every error that onebend raises on purpose; the command line prints it without a traceback.

    Args:
        about: a key of `sections.toml`, where docs/troubleshooting.md says more of it.
    """

    def __init__(self, text: str = "", *, about: str = "") -> None:
        super().__init__(text)
        self.about = about


class RecordingError(OnebendError):
    """A recording on disk cannot be used as it is: a missing file, a bad key, an unreadable video or log."""


class ObservationError(OnebendError):
    """The files are readable but do not make observations: no tag found, no overlap of clocks, no push."""


class LearningError(OnebendError):
    """The observations cannot determine what was asked: too few loaded frames, a stiffness that is not positive."""


class MechanicsError(OnebendError):
    """A beam or load that has no meaning (negative length, stiffness not positive), or no equilibrium was found."""


class ResultsError(OnebendError):
    """Results cannot be written or read: the folder is taken, the model file is damaged or of another version."""


class ControlError(OnebendError):
    """What was asked of a beam cannot be done: a goal that no force reaches, a place or a bound without a meaning."""


class ExportError(OnebendError):
    """A beam cannot be written for other software: no mass, an unknown kind of file, a setting without meaning."""


class MissingPackageError(OnebendError, ImportError):
    """An optional package is not installed, or does not load."""

    def __init__(self, text: str = "", *, name: str | None = None) -> None:
        OnebendError.__init__(self, text)
        self.name = name


class StudioError(OnebendError):
    """What the page asked for is not there, or not in the studio's folder."""


PAGE = "troubleshooting.md"  # in docs/


@cache
def sections() -> dict[str, str]:
    """The section of the page for each thing that a warning or an error may be about: `sections.toml`."""
    import tomllib  # here: most commands warn of nothing

    return tomllib.loads(Path(__file__).with_name("sections.toml").read_text(encoding="utf-8"))


def section(about: str) -> str:
    """The page and its section, as `troubleshooting.md#the-film-hung`; "" where `about` is empty."""
    return f"{PAGE}#{sections()[about]}" if about else ""


def reference(about: str) -> str:
    """Where to read of it, as printed below a warning; "" where `about` is empty."""
    return f"docs: {section(about)}" if about else ""


def told(error: Exception) -> str:
    """The words of an error, and where to read of it where it says what it is about."""
    return "\n".join(filter(None, (str(error), reference(getattr(error, "about", "")))))
