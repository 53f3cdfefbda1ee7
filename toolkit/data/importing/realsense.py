"""Recordings of RealSense cameras, read by pyrealsense2."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from pydantic import Field

from toolkit.data.importing.folders import TOLERANCE_S
from toolkit.data.importing.recording import Importer, Recording, Shot, pinhole_frame
from toolkit.data.importing.settings import HandEye, body_to_camera
from toolkit.data.importing.streams import Pixels, Stream
from toolkit.data.importing.trajectory import read_trajectory, without_pose
from toolkit.errors import ToolkitError
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Frame


class RealSenseConfig(PluginConfig):
    """Settings of `RealSense`."""

    poses: Path = Field(description="file of `time x y z qx qy qz qw` lines, by the clock of the recording's frames")
    hand_eye: HandEye | None = None
    tolerance: float = Field(TOLERANCE_S, gt=0, description="seconds that stamps may lie apart")


_PLAYS = 3
"""The library pairs frames while they play, and on a busy machine it leaves some out."""


class RealSense(Plugin[RealSenseConfig], Importer):
    """Colour and depth of a RealSense recording, depth aligned to colour, with poses from a file.

    A recording holds no poses: `poses` is what the arm reported, over time, in seconds of the clock that frames are
    stamped by (with global time, the default of D400 cameras, the computer's). Recordings are .bag files, or .db3 files
    of newer versions. Pairs of colour and depth that are further apart than the tolerance are left out.
    """

    stage, name = "import kind", "realsense"

    def read(self, source: Path) -> Recording:
        config = self.config
        trajectory = read_trajectory(config.poses)
        T_body_camera = body_to_camera(config.hand_eye)
        stamps = [stamp for stamp, _ in _pairs(source, config.tolerance)]
        bodies = {index: trajectory.at(stamp, config.tolerance) for index, stamp in enumerate(stamps)}
        shots = tuple(
            Shot(index, f"{stamps[index]:.6f}", body @ T_body_camera)
            for index, body in bodies.items()
            if body is not None
        )
        if not shots:
            seen = f"stamped {stamps[0]:.3f} s to {stamps[-1]:.3f} s" if stamps else "none with colour and depth"
            raise ToolkitError(
                f"'{source}' has no frame with a pose within {config.tolerance:g} s; its frames are {seen}"
            )

        def load(chosen: Sequence[Shot]) -> list[Frame]:
            wanted = {stamps[shot.index] for shot in chosen}
            seen: dict[float, Pixels] = {}
            for _ in range(_PLAYS):
                for stamp, (stream, frames) in _pairs(source, config.tolerance):
                    if stamp in wanted and stamp not in seen:
                        seen[stamp] = stream.pixels(frames)
                if len(seen) == len(wanted):
                    break
            if len(seen) < len(wanted):
                raise ToolkitError(f"'{source}' did not play all its frames again; try once more, with less going on")
            found = [(shot, seen[stamps[shot.index]]) for shot in chosen]
            return [pinhole_frame(shot, p.rgb, p.depth, p.K, p.distortion) for shot, p in found]

        return Recording(shots, load, notes=without_pose(len(stamps) - len(shots), config.tolerance, "frames"))


def _pairs(source: Path, tolerance: float) -> Iterator[tuple[float, tuple[Stream, Any]]]:
    """For every colour image its time in seconds, and the frames with the depth nearest to it, if that is near."""
    with Stream.of_file(source) as stream:
        for stamp, frames in groupby(stream.frames(), stream.color_time):
            best = min(frames, key=stream.gap)
            if stream.gap(best) <= tolerance:
                yield stamp, (stream, best)
