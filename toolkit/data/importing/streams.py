"""A RealSense camera, live or played from a file, as pairs of colour and aligned depth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.data.bop.depth import metres
from toolkit.data.importing.recording import library
from toolkit.errors import ToolkitError
from toolkit.types import Float, Image

_WAIT_MS = 2000
"""No camera pauses for so long between two frames; a file does on a busy machine, and says when it has ended."""


@dataclass(frozen=True, eq=False)
class Pixels:
    """What one pair shows.

    Attributes:
        rgb: (H, W, 3) uint8.
        depth: (H, W) float32 metres, aligned to colour, 0 where nothing was measured.
        K: (3, 3) of both, pixels.
        distortion: of both, in OpenCV's order.
    """

    rgb: Image
    depth: Float
    K: Float
    distortion: tuple[float, ...]


class Stream:
    """An open pipeline of pyrealsense2, closed when its `with` block ends.

    Args:
        rs: the module.
        config: says what it streams, and from where.
        what: names it in answers.

    Raises:
        ToolkitError: there is no such camera or file, or it streams no colour and depth.
    """

    def __init__(self, rs: Any, config: Any, what: str) -> None:
        self._what = what
        self._align = rs.align(rs.stream.color)
        self._models = rs.distortion
        self._pipeline = rs.pipeline()
        self._playback, self._playing = None, rs.playback_status.playing
        try:
            device = config.resolve(rs.pipeline_wrapper(self._pipeline)).get_device()
            if device.is_playback():
                # Before it starts: what plays in real time skips frames that nobody waits for.
                self._playback = device.as_playback()
                self._playback.set_real_time(False)
            self._pipeline.start(config)
        except RuntimeError as error:
            raise ToolkitError(f"{what} cannot be opened: {error}") from error

    @classmethod
    def of_file(cls, path: Path) -> Stream:
        """Plays a recording from its beginning, every frame once."""
        rs = library("pyrealsense2", "realsense", f"'{path}'")
        if not path.is_file():
            raise ToolkitError(f"there is no recording '{path}'")
        config = rs.config()
        config.enable_device_from_file(str(path), False)
        return cls(rs, config, f"the recording '{path}'")

    @classmethod
    def of_camera(cls, width: int, height: int, rate: int) -> Stream:
        """Colour and depth of a camera that is connected, of that many pixels and frames per second.

        The first second is not used: exposure settles in it.
        """
        rs = library("pyrealsense2", "realsense", "a RealSense camera")
        config = rs.config()
        config.enable_stream(rs.stream.color, width, height, rs.format.rgb8, rate)
        config.enable_stream(rs.stream.depth, width, height, rs.format.z16, rate)
        stream = cls(rs, config, "the RealSense camera")
        for _, _ in zip(range(rate), stream.frames(), strict=False):
            pass
        return stream

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self._pipeline.stop()

    def frames(self) -> Iterator[Any]:
        """Sets of frames that hold colour and depth, as they come, until there are no more."""
        while True:
            there, frames = self._pipeline.try_wait_for_frames(_WAIT_MS)
            if not there:
                if self._playback is not None and self._playback.current_status() == self._playing:
                    continue
                return
            if frames.get_color_frame() and frames.get_depth_frame():
                yield frames

    def color_time(self, frames: Any) -> float:
        """When the colour image was taken, in seconds of the clock that frames are stamped by."""
        return float(frames.get_color_frame().get_timestamp()) / 1e3

    def gap(self, frames: Any) -> float:
        """Seconds between colour and depth."""
        return abs(self.color_time(frames) - float(frames.get_depth_frame().get_timestamp()) / 1e3)

    def pixels(self, frames: Any) -> Pixels:
        """Colour, and depth aligned to it.

        Raises:
            ToolkitError: colour is not in RGB or BGR of 8 bits, or its lens is not OpenCV's.
        """
        aligned = self._align.process(frames)
        color, depth = aligned.get_color_frame(), aligned.get_depth_frame()
        profile = color.profile.as_video_stream_profile()
        raw, kind = np.array(color.get_data()), profile.format().name
        if kind not in ("rgb8", "bgr8"):
            raise ToolkitError(f"{self._what}: colour is {kind}; record it as rgb8")
        i = profile.get_intrinsics()
        where = Path(self._what)
        measured = metres(np.array(depth.get_data()), depth.get_units() * 1e3, where, "the camera")
        K = np.array([[i.fx, 0, i.ppx], [0, i.fy, i.ppy], [0, 0, 1]])
        rgb = raw if kind == "rgb8" else np.ascontiguousarray(raw[..., ::-1])
        return Pixels(rgb, measured, K, self._distortion(i))

    def _distortion(self, intrinsics: Any) -> tuple[float, ...]:
        """OpenCV's coefficients of the colour camera; most D400 cameras state none."""
        if not any(intrinsics.coeffs):
            return ()
        if intrinsics.model not in (self._models.brown_conrady, self._models.inverse_brown_conrady):
            raise ToolkitError(f"{self._what}: the lens is {intrinsics.model.name}, and only OpenCV's model is read")
        k1, k2, p1, p2, k3 = map(float, intrinsics.coeffs)
        if intrinsics.model == self._models.inverse_brown_conrady:
            # To first order, what undistorts is what distorts with the other sign; these lenses bend by a few pixels.
            return (-k1, -k2, -p1, -p2, -k3)
        return (k1, k2, p1, p2, k3)
