"""RealSense cameras through `pyrealsense2`: their colour, or their left infrared picture, which a global shutter takes.

The calls are those of librealsense 2 (its API reference: pipeline, config, sensor, frame). Stamps are the camera's own
clock: the software's translation to this machine's time, which is renewed as it goes, is switched off.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from onebend.capture.clocks import Clock, StampTiming
from onebend.capture.sources import End, Frame, of_yuyv
from onebend.errors import RecordingError
from onebend.extras import package

Stream = Literal["color", "infrared"]
STREAMS: tuple[Stream, ...] = ("color", "infrared")
EXPOSURE_UNITS = {"color": 1e-4, "infrared": 1e-6}  # s, of the option `exposure`
SILENT = 5.0  # s without a picture
TIMING = StampTiming(delay=0.01, delay_error=0.03)


@dataclass(frozen=True)
class RealSenseSettings:
    """What is asked of the camera; what it cannot give it refuses."""

    stream: Stream = "color"
    width: int = 1280  # px
    height: int = 720
    fps: int = 30
    exposure: float = math.nan  # s; NaN: the camera chooses


class RealSenseCamera:
    """The camera with this serial number; without one, the first that is found."""

    def __init__(self, serial: str = "", settings: RealSenseSettings = RealSenseSettings()) -> None:
        self.name = f"the RealSense camera {serial}".rstrip()
        self.timing = TIMING
        self._serial, self._settings = serial, settings
        self._pipeline: Any = None
        self._clock: Clock | None = None
        self._heard = 0.0

    def open(self, clock: Clock) -> None:
        """Begin to stream.

        Raises:
            RecordingError: the package is missing, there is no such camera, or it has no such stream.
        """
        made, asked = package("pyrealsense2", "realsense"), self._settings
        pipeline, config = made.pipeline(), made.config()
        if self._serial:
            config.enable_device(self._serial)
        size = (asked.width, asked.height)
        if asked.stream == "infrared":
            config.enable_stream(made.stream.infrared, 1, *size, made.format.y8, asked.fps)
        else:
            config.enable_stream(made.stream.color, *size, made.format.yuyv, asked.fps)
        try:
            profile = pipeline.start(config)
        except RuntimeError as wrong:
            raise RecordingError(
                f"{self.name} gives no {asked.stream} pictures of {asked.width}x{asked.height} at {asked.fps} a second "
                f"({wrong}). Is it plugged in, and does no other program have it? realsense-viewer shows its streams."
            ) from None
        self._pipeline = pipeline
        try:
            self._set(made, profile)
        except RuntimeError as wrong:
            self.close()
            raise RecordingError(f"{self.name} does not take its settings ({wrong}). Plug it in again.") from None
        self._clock, self._heard = clock, clock.now()

    def read(self, wait: float) -> Frame | End | None:
        """The next picture."""
        assert self._clock is not None
        try:
            came, frames = self._pipeline.try_wait_for_frames(max(1, round(1000.0 * wait)))
            now = self._clock.now()
            if not came:
                silent = now - self._heard > SILENT
                return End(f"{self.name} sends no pictures any more", fault=True) if silent else None
            infrared = self._settings.stream == "infrared"
            frame = frames.get_infrared_frame(1) if infrared else frames.get_color_frame()
            if not frame:
                return None
            data = np.asanyarray(frame.get_data())
            stamp, number = 1e-3 * float(frame.get_timestamp()), int(frame.get_frame_number())
        except RuntimeError as wrong:
            return End(f"{self.name} is gone ({wrong}): its cable was pulled", fault=True)
        self._heard = now
        if infrared:
            return Frame(data.copy(), stamp, now, number)
        luma, colour = of_yuyv(np.ascontiguousarray(data).view(np.uint8).reshape(*data.shape[:2], 2))
        return Frame(luma, stamp, now, number, colour)

    def close(self) -> None:
        """Stop it."""
        if self._pipeline is not None:
            with suppress(RuntimeError):  # it is gone
                self._pipeline.stop()
            self._pipeline = None

    def _set(self, made: Any, profile: Any) -> None:
        """Its own clock, no pattern of its projector over the tags, and the exposure, of the sensors that have them."""
        asked = self._settings
        stream = made.stream.infrared if asked.stream == "infrared" else made.stream.color
        for sensor in profile.get_device().query_sensors():
            mine = any(one.stream_type() == stream for one in sensor.get_stream_profiles())
            wanted = {made.option.global_time_enabled: 0.0, made.option.emitter_enabled: 0.0}
            if mine and asked.exposure > 0.0:
                wanted[made.option.enable_auto_exposure] = 0.0
                wanted[made.option.exposure] = max(1.0, round(asked.exposure / EXPOSURE_UNITS[asked.stream]))
            for option, value in wanted.items():
                if sensor.supports(option):
                    sensor.set_option(option, value)
