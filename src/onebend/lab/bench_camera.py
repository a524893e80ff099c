"""One picture at a time of a virtual bench, drawn in milliseconds; `filming` draws whole films."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from onebend.errors import RecordingError
from onebend.lab import filming, rendering
from onebend.lab.bench import PushProfile
from onebend.lab.virtual import VirtualBench
from onebend.recording.entries import Recording
from onebend.recording.video import Picture
from onebend.records import Array


class BenchCamera:
    """The camera of a bench whose beam goes where it is led: luma alone, no shadows, as fast as it is watched."""

    def __init__(self, bench: VirtualBench, rec: Recording, *, noise: float, sees: float, seed: int) -> None:
        """`rec`: says which camera and tags; `noise`: of 255; `sees`: rad, it has in view a beam bent to such an arc.

        Raises:
            RecordingError: recording.toml has no camera.
        """
        entry = rec.camera
        if entry is None:
            raise RecordingError("a virtual camera needs a [camera] in recording.toml, to be the one that is described")
        middle = (entry.cx - (entry.width - 1) / 2, entry.cy - (entry.height - 1) / 2)
        dist: Any = tuple([*entry.dist, 0.0][:5])
        camera = rendering.Camera(width=entry.width, height=entry.height, focal=entry.fx, centre=middle, dist=dist)
        always = PushProfile(0.0, before=0.0, hold=1e9, after=0.0, at_s=bench.push.at_s)
        self._filming = filming.Filming(replace(bench, push=always), camera=camera, tag_size=rec.tags.size)
        self._filming = replace(self._filming, scene=replace(self._filming.scene, noise=noise, exposure=0.005))
        rng = np.random.default_rng([seed, 22])
        self._cast = filming.cast_of(self._filming, rng)
        bends = np.linspace(-sees, sees, 22)
        reach = _arcs(bench.beam.length, bends)
        wide = np.concatenate([reach + rec.tags.size, reach - rec.tags.size])
        beam = np.zeros((len(bends), len(filming.PLACES), 4))
        beam[..., :2] = reach.reshape(len(bends), -1, 2)
        view = rendering.view_from(camera, wide)
        self._staged: rendering.StaticScene = filming.stage_of(self._filming, self._cast, view, beam, seed)
        self._rng = rng
        lit = np.asarray(self._staged.table.y * self._staged.light)
        self._tables = [self._grey(lit) for _ in range(_TABLES)]

    def faces(self, poses: Array) -> Array:
        """(m + 1, 6) as of `filming.tag_faces`, of one beam with poses (121, 3)."""
        flat = np.zeros((1, len(filming.PLACES)))
        return np.asarray(filming.tag_faces(self._filming, poses[None], flat, flat)[0])

    def picture(self, poses: Array, force: Array, time: float) -> Picture:
        """(H, W) of the beam with poses (121, 3) at `PLACES` under `force` (2,) N."""
        tags, flat = self.faces(poses), np.zeros(len(filming.PLACES))
        turn = math.atan2(force[1], force[0]) if float(np.hypot(*force)) > 1e-3 else 0.5 * math.pi
        cast = replace(self._cast, push=replace(self._cast.push, direction=turn, turn=0.0))
        drawing = filming.moment_of(cast, time, np.column_stack([poses, flat]), tags, self._cast.push.at_s)
        y = self._tables[int(self._rng.integers(_TABLES))].copy()
        self._draw(y, drawing)
        return y

    def _grey(self, level: rendering.Image) -> Picture:
        """Levels of 8 bit, with the sensor's noise."""
        noise = rendering.grain_of(self._staged.grain, level.shape, self._rng) * np.float32(
            self._filming.scene.noise / 255.0
        )
        grey = (level + noise) * np.float32(rendering.RANGE) + np.float32(rendering.BLACK + 0.5)
        return np.asarray(np.clip(grey, 0.0, 255.0).astype(np.uint8))

    def _draw(self, y: Picture, drawing: rendering.Drawing) -> None:
        """All that moves, into the part of the picture where it is."""
        staged, scope = self._staged, self._staged.scope
        seen = [rendering.seen_at(staged.view, layer, drawing) for layer in drawing.layers]
        around = np.concatenate([px.reshape(-1, 2) for px in seen])
        here = rendering.clipped(
            rendering.box_around(around, scope.right, scope.bottom, 2.0 * rendering.BLURRED), scope
        )
        part = staged.table.y[here.slices].copy()
        for layer, px in zip(drawing.layers, seen, strict=True):
            box = rendering.clipped(rendering.box_around(px, scope.right, scope.bottom), here)
            if 0 not in box.shape:
                where = part[box.within(here)]
                where += rendering.coverage(px, box) * (np.float32(rendering.yuv(layer.colour)[0]) - where)
        y[here.slices] = self._grey(gaussian_filter(part, staged.scene.blur, truncate=2.5) * staged.light[here.slices])


_TABLES = 8  # pictures of the empty table, each with its own noise


def _arcs(length: float, bends: Array) -> Array:
    """(N, 2) m of arcs of a beam of this length, bent by angles (B,) rad that are not zero."""
    s, bend = filming.PLACES[None, :], bends[:, None]
    return length * np.stack([np.sin(bend * s) / bend, (1.0 - np.cos(bend * s)) / bend], axis=-1).reshape(-1, 2)
