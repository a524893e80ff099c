"""Beam, tags and contact of a bench at the moments that a film shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.lab.effects.droop import droop
from onebend.lab.effects.rod_march import RodMotion
from onebend.lab.filming.film_setup import Filming, motive_of
from onebend.lab.filming.movement import PLACES, BeamShapes, shapes_at
from onebend.lab.virtual import motion_of, tag_places, tag_poses_on
from onebend.records import Array


@dataclass(frozen=True)
class Moments:
    """T moments."""

    shapes: BeamShapes  # clamp's frame
    beam: Array  # (T, 121, 4) x, y, angle, z at `PLACES`, in the room
    tags: Array  # (T, m + 1, 6) x, y, angle, z and the face's tilts, in the room; the base tag first
    contact: Array  # (T,) s, where the tool pushes

    def part(self, which: slice) -> Moments:
        """Some of them."""
        shapes = self.shapes
        few = BeamShapes(shapes.time[which], shapes.force[which], shapes.xy[which], shapes.angle[which])
        return Moments(few, self.beam[which], self.tags[which], self.contact[which])


def followed(filming: Filming, until: float) -> RodMotion | None:
    """The beam through the whole film where its bench has effects that move it; None: it moves as without them."""
    return motion_of(filming.bench, until, at=PLACES, gravity=motive_of(filming).gravity)


def moments_at(filming: Filming, motion: RodMotion | None, time: Array) -> Moments:
    """Everything at times (T,) [s] that rise; before 0 the beam is at rest.

    Raises:
        MechanicsError: the beam snaps through, or its mass is needed and not known.
    """
    bench = filming.bench
    if motion is None:
        shapes = shapes_at(bench.beam, bench.push, time, motive_of(filming))
        contact = np.full(len(time), bench.push.at_s)
    else:
        poses = motion.poses(time, PLACES)
        shapes = BeamShapes(time, bench.push.force(time), poses[..., :2], poses[..., 2])
        contact = motion.contacts(time)
    z, slope = droop(bench.beam, bench.effects.droop, PLACES, shapes.xy, shapes.angle)
    beam = np.concatenate([shapes.xy, shapes.angle[..., None], z[..., None]], axis=-1)
    tags = tag_faces(filming, shapes, z, slope)
    return Moments(shapes, in_room(beam, filming.base_angle), in_room(tags, filming.base_angle), contact)


def tag_faces(filming: Filming, shapes: BeamShapes, z: Array, slope: Array) -> Array:
    """(T, m + 1, 6) the base tag and those on the beam, clamp's frame: x, y, angle, z and tilts about and along it."""
    bench, count = filming.bench, len(shapes.time)
    effects, s = bench.effects, np.clip(tag_places(bench), 0.0, 1.0)
    xy, angle = shapes.at(s)
    flat = tag_poses_on(bench, xy, angle)
    heights = np.array(effects.tag_heights) if effects.tag_heights else np.zeros(len(s))
    tilts = np.array(effects.tag_tilts) if effects.tag_tilts else np.zeros((len(s), 2))
    up = np.stack([np.array([np.interp(s, PLACES, one) for one in of]) for of in (z, slope)], axis=-1)
    about = np.broadcast_to(tilts[:, :1], (count, len(s), 1))
    on_beam = [flat, up[..., :1] + heights[:, None], about, up[..., 1:] + tilts[:, 1:]]
    base = np.tile(np.array([*bench.base, effects.base_height, 0.0, 0.0]), (count, 1, 1))
    return np.concatenate([base, np.concatenate(on_beam, axis=-1)], axis=1)


def in_room(pose: Array, base_angle: float) -> Array:
    """Poses (..., 3 or more) in the room, from the clamp's frame."""
    cos, sin = np.cos(base_angle), np.sin(base_angle)
    xy = pose[..., :2] @ np.array([[cos, sin], [-sin, cos]])
    return np.concatenate([xy, pose[..., 2:3] + base_angle, pose[..., 3:]], axis=-1)
