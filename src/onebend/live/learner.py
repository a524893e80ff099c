"""k(s) while the beam is being pushed: the posterior of the marker-space fit, renewed with every frame.

A bounded set of key frames stands for all frames so far (`key_frames.py`). Every other update solves for the posterior
over all of them (`smoother.py`, `posterior.py`). Where the estimate has moved, they are linearised anew, all at one
point, so a poor start is forgotten. Memory and time per update do not grow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.model import Beam
from onebend.beam.stiffness import Profile, UncertainStiffness, Uniform, by_legendre
from onebend.errors import LearningError
from onebend.learning.allowances import OF_ONE
from onebend.learning.parameters import Spline, with_width
from onebend.learning.posterior import Nuisance
from onebend.live.hyperparameters import LiveHyperparameters, OnlineSettings
from onebend.live.key_frames import checked_frame
from onebend.live.model import session_of
from onebend.live.smoother import Smoother, start_of
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray

_HELD = frozenset({"patches"})  # what k(s) of a fit has in it
_STIFFER = 0.2  # added to log k where the estimate has no equilibrium under a force that the beam withstood


@dataclass(frozen=True)
class Update:
    """The result of one frame."""

    innovation: Array  # (m, 3) m, m, rad: measured minus expected; NaN where a tag was not seen
    distance: Array  # (m,) the same in sd of what was expected (root of chi-square with 3 degrees); NaN likewise
    accepted: BoolArray  # (m,) tags that were used
    solved: bool  # False: the estimate has no equilibrium under this force, nothing was learned from the frame
    doubts: tuple[str, ...]  # reasons not to rely on k(s) after this frame; usually none


class OnlineLearner:
    """Learns k(s) of one beam frame by frame. Not thread-safe."""

    @one_blas_thread
    def __init__(
        self,
        length: float,
        marker_s: ArrayLike,
        start: Profile | float | UncertainStiffness,
        *,
        traced: ArrayLike | None = None,
        width: ArrayLike | None = None,
        mass: float = 0.0,
        gain_sd: float = 0.0,
        settings: OnlineSettings = OnlineSettings(),
    ) -> None:
        """A learner that has seen nothing.

        Args:
            length: m.
            marker_s: (m,) the tags' places along the beam.
            traced: (m,) which of them are points of the body's outline; None: none. Only what is across it counts.
            width: (P, 2) places s and the body's width there [m], by its outline; None: not seen.
            start: stiffness to begin with [N m], a poor guess will do; or what a fit has found, to go on from there.
            mass: kg, needed where gravity acts in the plane.
            gain_sd: of the force sensor's common scale; it widens the band and is not learned.

        Raises:
            LearningError: a length or stiffness that is not positive, tags outside (0, 1], settings without meaning.
        """
        s = np.asarray(marker_s, dtype=float)
        _check(length, s, mass)
        settings.check()
        self._held = _HELD if isinstance(start, UncertainStiffness) else frozenset()
        thickness, tag_size = (np.nan if v is None else v for v in (settings.thickness, settings.tag_size))
        self.settings, self._gain_sd, spline = settings, gain_sd, Spline(settings.functions)
        self._session = session_of(
            spline if width is None else with_width(spline, np.asarray(width, dtype=float)),
            s,
            settings.sds,
            traced=None if traced is None else np.asarray(traced, dtype=bool),
            length=length,
            mass=mass,
            allowances=settings.allowances - self._held,
            thickness=thickness,
            tag_size=tag_size,
        )
        self._state = Smoother(self._session, start_of(self._session.layout, start), settings)
        self._doubts = start.doubts if isinstance(start, UncertainStiffness) else ()  # what it rests on stays in doubt
        self._last: tuple[float, Array] | None = None
        self._frames = 0

    @one_blas_thread
    def update(
        self,
        time: float,
        xy: ArrayLike,
        angle: ArrayLike,
        covariance: ArrayLike,
        force: ArrayLike,
        push_s: float = 1.0,
        *,
        loaded: bool = True,
        gravity: ArrayLike = (0.0, 0.0),
    ) -> Update:
        """One frame.

        Args:
            time: s, later than the frame before.
            xy: (m, 2) m, the tags in the beam's frame; NaN where not seen.
            angle: (m,) rad, whole turns do not matter; NaN where not seen. Of an outline's point its direction there.
            covariance: (m, 3, 3) of (x, y, angle) of every tag.
            force: (2,) N on the beam, in its frame, as logged.
            push_s: place of the force.
            loaded: False where nothing touches the beam: the frame then shows the rest shape and the log's zero. Leave
                out frames in which that is not sure.
            gravity: (2,) m/s^2 in the beam's frame.

        Raises:
            LearningError: shapes that do not fit, numbers that are not finite (missing tags apart), a covariance that
                is not positive definite, time that does not go on, a place outside (0, 1], gravity without mass. The
                learner stays as it was.
        """
        traced = ~self._session.course.on_body
        tags, frame = len(traced), checked_frame(traced, time, xy, angle, covariance, force, push_s, loaded, gravity)
        if self._last is not None and not time > self._last[0]:
            raise LearningError(f"frames must come in order of time: {time:g} s after {self._last[0]:g} s")
        if np.any(frame.gravity != 0.0) and self._session.observations.stated.mass <= 0.0:
            raise LearningError("gravity acts in the plane, so the beam's mass must be given")
        rate = np.zeros(2) if self._last is None else (frame.force - self._last[1]) / (time - self._last[0])
        self._last = (time, frame.force)
        nothing = np.full((tags, 3), np.nan), np.full(tags, np.nan), np.zeros(tags, dtype=bool)
        state = self._state
        if loaded and not np.any(frame.visible):
            return Update(*nothing, solved=True, doubts=self._doubts + state.last_doubts)
        if not state.enter(frame, rate):
            state.stiffen(_STIFFER)
            return Update(*nothing, solved=False, doubts=self._doubts + state.last_doubts)
        gated = state.gate(frame)
        state.advance()
        self._frames += 1
        return Update(*gated, solved=True, doubts=self._doubts + state.last_doubts)

    @one_blas_thread
    def settle(self, rounds: int = 10) -> None:
        """Linearise all key frames anew and solve, several times: for the end of a push, not for a loop."""
        self._state.settle(rounds)

    @property
    def frames(self) -> int:
        """Count of the frames learned from."""
        return self._frames

    @property
    def left_out(self) -> tuple[str, ...]:
        """What the fit allows for and this learner does not: it takes the beam and the bench as ideal there,
        and its band holds no more of it than what the discrepancy takes in."""
        return tuple(sorted(OF_ONE - self._session.columns.keys() - self._held))

    @property
    @one_blas_thread
    def hyperparameters(self) -> LiveHyperparameters:
        """Sizes of the tags' noise and of the force error, as they are now."""
        noise, state = self._state.solution.process, self._state
        tags, load = (state.marker, float(np.max(state.misfit))), state.hyperparameters.load
        return LiveHyperparameters(*tags, noise.white, noise.coloured, noise.tau, noise.walk, load)

    @property
    @one_blas_thread
    def parameters(self) -> tuple[Array, Array]:
        """(n,) and (n, n): mean and covariance of all parameters; log k's coefficients come first."""
        return self._state.posterior()[:2]

    @property
    @one_blas_thread
    def stiffness(self) -> UncertainStiffness:
        """k(s) with its band, as it is now; while there are `doubts`, no place of it counts as identified."""
        spline, (mean, covariance, steps) = self._session.layout.spline, self._state.posterior()
        fine, onto, p = spline.finer, spline.on_finer, spline.count
        index = np.arange(p)
        if "patches" in self._session.columns:  # k(s) has them in it
            under_tags = self._session.layout.index["patches", -1].where
            index = np.append(index, np.arange(under_tags.start, under_tags.stop))
            onto = np.column_stack([onto, self._session.patches_on_finer])
        spread = onto @ covariance[np.ix_(index, index)] @ onto.T + np.tensordot(steps**2, spline.unseen, 1)
        coefficients, spread = onto @ mean[index], 0.5 * (spread + spread.T)
        return UncertainStiffness(
            fine.knots, coefficients, spread, self._gain_sd, doubts=self._doubts + self._state.doubts
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons not to rely on `stiffness` as it is now; usually none."""
        return self._doubts + self._state.doubts

    @one_blas_thread
    def nuisances(self) -> list[Nuisance]:
        """Every parameter but k's, before and after the frames so far."""
        mean, covariance = self.parameters
        sd, p = np.sqrt(np.diag(covariance)), self._session.layout.spline.count
        before = np.concatenate([np.ones(p), self._state.nuisance_sd])
        out = []
        for block in self._session.layout.blocks:
            if block.start >= 0 and block.name != "stiffness":
                values = zip(block.labels, mean[block.where], sd[block.where], before[block.where], strict=True)
                out += [Nuisance(n, block.unit, float(v), float(s), float(p)) for n, v, s, p in values]
        return out

    @property
    @one_blas_thread
    def beam(self) -> Beam:
        """The beam as it is now."""
        self._state.catch_up()
        rest = by_legendre(self._session.layout.get(self._state.x, "curvature"))
        length = self._session.length
        mass = Uniform(self._session.observations.stated.mass / length)
        return Beam(length, self.stiffness.profile, rest_curvature=rest, mass_per_length=mass)


def _check(length: float, marker_s: Array, mass: float) -> None:
    if not (np.isfinite(length) and length > 0.0):
        raise LearningError(f"a beam's length must be positive, got {length} m")
    if marker_s.ndim != 1 or len(marker_s) == 0 or not np.all((marker_s > 0.0) & (marker_s <= 1.0)):
        raise LearningError(f"tags are at s in (0, 1], got {marker_s.tolist()}")
    if not mass >= 0.0:
        raise LearningError(f"a beam's mass cannot be negative, got {mass} kg")
