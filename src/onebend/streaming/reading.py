"""One frame of a stream in metres and newtons, by what the frames before it showed of camera, clock and force log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.errors import ObservationError
from onebend.learning.replay import LiveFrame
from onebend.recording.camera.base import together
from onebend.recording.camera.tag_poses import Poses, drop, measure_poses, part, relative_to
from onebend.recording.force.cleaning import to_beam
from onebend.recording.toml.entries import Recording
from onebend.records import Array, Observations, View

AS_NEAR = 2.0  # sd of the clocks' offset: a force that is as near may be that of the frame
_WRONG, _LEAST_SD = 10.0, 0.02  # sd of a corner, px: as `camera.projection` leaves tags out
_TOUCHED_SD = 8.0  # of a tag's place: farther from rest than this,
_TOUCHED_SHARE = 0.02  # and than this share of the largest displacement so far, the beam is being pushed


@dataclass(frozen=True)
class FrameReader:
    """What turns a frame's corners and the log's rows into what the live learner takes."""

    offset: float  # s: log time less the frames' time
    offset_sd: float  # s
    view: View  # of the beam's frame
    tag_size: float  # m
    turn: Array  # (b + m,) rad of the tags, as written
    base_s: Array  # (b,) m, places of the base's tags on its x axis
    follows_base: bool  # camera or base move
    known_xy: Array  # (T, m, 2) m of the frames so far
    camera_part: Array  # (T, m, 3, 3) what all tags share by the camera, as noise of each
    rest_xy: Array  # (m, 2) m, NaN where unknown
    rest_sd: float  # m, of a tag in one frame
    to_beam: Array  # (2, 2), sign included: rows of the log times it are forces on the beam
    tare: Array  # (2,) N
    place: float  # of the push; NaN where the log says it
    gravity: Array  # (2,) m/s^2
    largest: float  # m, displacement so far

    def stands_in(self, ahead: float) -> float:
        """s: so far after the newest row of the log, by the clocks as they are known, a frame may be and take its force
        all the same. `ahead` [s] is what that row's time usually is ahead of a frame's as it comes in.

        What comes in together is usually of one time. Where the clocks say otherwise, but are not known well enough to
        rule that out, a frame would wait for the force of a later time: always, if their offset is wrong.
        """
        return float(np.clip(self.offset - ahead, 0.0, AS_NEAR * self.offset_sd))

    def poses(self, corners: Array) -> tuple[Array, Array, Array]:
        """(m, 2) m, (m,) rad and (m, 3, 3): the beam's tags in its frame, from corners (b + m, 4, 2) px."""
        noise = max(self.view.corner_sd, _LEAST_SD)
        poses, misfit, _ = measure_poses(self.view, corners[None], self.tag_size, noise=noise, refinements=1)
        poses = drop(poses, misfit > _WRONG * noise)
        poses = Poses(poses.xy, poses.angle - self.turn, poses.covariance)
        base = len(self.base_s)
        own = part(poses, slice(base, None))
        if self.follows_base:
            own = relative_to(together(part(poses, slice(base)), self.base_s.tolist()), own)
        xy, covariance = own.xy[0], own.covariance[0]
        seen = np.isfinite(xy).all(axis=1)
        away = np.sum((self.known_xy - xy)[:, seen] ** 2, axis=(1, 2))
        if seen.any() and np.isfinite(away).any():
            covariance = covariance + self.camera_part[int(np.nanargmin(away))]
        return xy, np.where(seen, own.angle[0], np.nan), covariance

    def force_on_beam(self, logged: Array) -> Array:
        """(2,) N of a row (2,) of the log, its zero that of the first rest."""
        return np.asarray(logged @ self.to_beam - self.tare)

    def pushed(self, xy: Array) -> bool | None:
        """Whether tags at (m, 2) m show the beam pushed; None where that is not sure."""
        away = np.linalg.norm(xy - self.rest_xy, axis=1)
        if not np.isfinite(away).any():
            return None
        return bool(np.nanmax(away) > max(_TOUCHED_SD * self.rest_sd, _TOUCHED_SHARE * self.largest)) or None

    def frame(self, time: float, corners: Array, logged: Array) -> LiveFrame | None:
        """What the learner takes of a frame at `time` [s, the frames' clock] with a row (2 or 3) of the log; None where
        nothing is to be learned from it: no tag, no force, or no sure contact."""
        xy, angle, covariance = self.poses(corners)
        pushed = self.pushed(xy)
        place = self.place if len(logged) == 2 else float(logged[2])
        if pushed is None or not np.isfinite(logged).all() or not 0.0 < place <= 1.0:
            return None
        force = self.force_on_beam(logged[:2])
        return LiveFrame(time + self.offset, xy, angle, covariance, force, place, pushed, self.gravity)


def reader_of(rec: Recording, seen: Observations) -> FrameReader:
    """The reader that goes on from what was observed so far, of frames that show a rest and a push.

    Raises:
        ObservationError: there is no camera or no force.
    """
    view, clock, clean, force, push = seen.source.view, seen.source.clock, seen.source.clean_force, rec.force, rec.push
    if view is None or clock is None or clean is None or force is None or push is None:
        raise ObservationError(f"{rec.name}: a film, a force log and where it acts are needed to go on frame by frame")
    m = len(seen.tag_id)
    shared = np.zeros((len(seen.time), m, 3, 3))
    if seen.by_camera is not None:
        shared = seen.by_camera @ np.swapaxes(seen.by_camera, -1, -2)
    away = np.linalg.norm(seen.xy - seen.rest_xy, axis=-1)
    variance = np.trace(seen.covariance[..., :2, :2], axis1=-2, axis2=-1)
    sign = -1.0 if force.acts_on == "robot" else 1.0
    return FrameReader(
        offset=clock.offset,
        offset_sd=clock.sd,
        view=view,
        tag_size=rec.tags.size,
        turn=np.array([tag.turn for tag in (*rec.tags.on_base, *rec.tags.on_beam)]),
        base_s=np.array([tag.s * rec.beam.length for tag in rec.tags.on_base]),
        follows_base=any(remark.about == "base moves" for remark in seen.source.remarks),
        known_xy=seen.xy,
        camera_part=np.asarray(shared),
        rest_xy=seen.rest_xy,
        rest_sd=float(np.sqrt(np.nanmedian(variance))),
        to_beam=sign * to_beam(force.rotation),
        tare=clean.tare,
        place=push.at,
        gravity=seen.gravity[-1],
        largest=float(np.nanmax(away)) if np.isfinite(away).any() else 0.0,
    )
