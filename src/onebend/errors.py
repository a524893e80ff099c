"""The few named errors of onebend, and where docs/troubleshooting.md says more of errors and warnings.

Every message says what is wrong, where, and what to do. Every warning says what it is about by a key of `SECTIONS`,
whatever its words are, and so does an error that has a section of its own (`tests/whole/test_troubleshooting.py`).
"""

from __future__ import annotations


class OnebendError(Exception):
    """Base of every error that onebend raises on purpose; the command line prints it without a traceback.

    Args:
        about: a key of `SECTIONS`, where docs/troubleshooting.md says more of it.
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

SECTIONS: dict[str, str] = {
    # the verdict
    "not trusted": "ks-is-not-to-be-trusted",
    "miss": "the-fit-misses-the-tags",
    "not converged": "the-fit-did-not-converge",
    "unexplained": "there-is-more-in-the-recording-than-the-fit-allows-for",
    "not identified": "ks-is-not-identified",
    "no scale": "the-size-of-ks-is-not-identifiable",
    "mass unknown": "the-mass-is-not-identifiable",
    "tag missed": "the-simulated-beam-misses-a-tag",
    "another beam": "the-validation-misses-by-more-than-the-noise",
    "sensed misfit": "no-force-explains-the-shapes",
    "sensed gain": "the-log-shows-another-force-than-the-shape",
    "no validation": "a-recording-cannot-validate-itself",
    "pose": "no-equilibrium-is-near-the-points-of-a-pose",
    "no equilibrium": "the-simulated-beam-snaps-or-buckles",
    "beyond what was learned": "the-force-is-larger-than-those-learned-from",
    "no regression": "the-papers-regression-found-no-beam",
    # the force
    "axes": "the-force-contradicts-the-bending",
    "force direction": "the-force-contradicts-the-bending",
    "axis scale": "the-force-contradicts-the-bending",
    "force unit": "the-force-may-be-in-another-unit",
    "constant force": "a-force-never-changes",
    "sensor's end": "the-sensor-is-at-the-end-of-its-range",
    "no rest": "no-rest-before-the-push",
    "drift": "the-forces-zero-drifted",
    "bad rows": "rows-or-pictures-are-missing",
    "push place": "the-push-acts-elsewhere",
    "push beside": "the-push-acts-elsewhere",
    "tool place": "the-film-shows-the-tool-elsewhere",
    # the clocks
    "clock": "force-and-tags-disagree-in-time",
    "no overlap": "film-and-log-do-not-overlap",
    # the film
    "unseen tag": "a-tag-is-never-seen",
    "small tags": "tags-are-too-small-in-the-picture",
    "no plane": "the-tags-lie-in-no-flat-plane",
    "outline": "the-bodys-outline-is-lost",
    "film hung": "the-film-hung",
    "frame rate": "the-frame-rate-is-not-as-written",
    "base moves": "the-base-moves",
    "camera": "the-cameras-numbers-are-unlikely",
    "scale": "lengths-in-the-picture-are-off",
    "out of plane": "the-beam-leaves-the-plane",
    # the tags, the clamp and the beam
    "along": "a-tag-is-not-where-it-is-written",
    "across": "a-tag-is-not-where-it-is-written",
    "turn": "a-tag-is-not-where-it-is-written",
    "tag places": "a-tag-is-not-where-it-is-written",
    "loose": "a-tag-moved-on-the-beam",
    "clamp": "the-clamp-is-turned-gives-or-slips",
    "origin": "the-clamp-is-turned-gives-or-slips",
    "clamp gives": "the-clamp-is-turned-gives-or-slips",
    "slip": "the-clamp-is-turned-gives-or-slips",
    "free clamp": "the-clamps-direction-was-left-free",
    "length": "the-beams-length-is-not-as-written",
    "stretch": "the-beam-stretches-or-shears",
    "shear": "the-beam-stretches-or-shears",
    "viscous": "the-shape-lags-behind-the-force",
    "creep": "the-beam-creeps",
    "weight": "a-weight-bends-the-beam",
    "mass": "a-weight-bends-the-beam",
    "rest shape": "the-beam-is-bent-at-rest",
    "curvature": "the-beam-is-bent-at-rest",
    "stiffness along": "ks-varies-otherwise-than-stated",
    "rest change": "the-beam-is-bent-at-rest",
    "swing": "the-swing-is-not-as-the-model-says",
    "frequencies": "a-frequency-is-not-as-the-fit-says",
    "no material": "youngs-modulus-is-that-of-no-material",
    # recording.toml
    "two sections": "the-recordings-state-different-sections",
    "unit": "a-number-looks-written-in-another-unit",
    "wide tolerance": "a-tolerance-is-very-wide",
    # bags
    "no stamps": "a-topic-has-no-header-stamps",
    "tool axes": "the-forces-axes-turn-with-the-tool",
    "bag's axes": "a-bag-does-not-say-how-the-force-lies",
    "damaged bag": "a-bag-is-damaged",
    # other commands, and files
    "calibration": "the-calibration-is-weak",
    "picture failed": "a-picture-could-not-be-drawn",
    "changed file": "a-file-was-changed",
}


def section(about: str) -> str:
    """The page and its section, as `troubleshooting.md#the-film-hung`; "" where `about` is empty."""
    return f"{PAGE}#{SECTIONS[about]}" if about else ""


def reference(about: str) -> str:
    """Where to read of it, as printed below a warning; "" where `about` is empty."""
    return f"docs: {section(about)}" if about else ""


def told(error: Exception) -> str:
    """The words of an error, and where to read of it where it says what it is about."""
    return "\n".join(filter(None, (str(error), reference(getattr(error, "about", "")))))
