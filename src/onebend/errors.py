"""The few named errors of onebend. Every message says what is wrong, where, and what to do."""

from __future__ import annotations


class OnebendError(Exception):
    """Base of every error that onebend raises on purpose; the command line prints it without a traceback."""


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
