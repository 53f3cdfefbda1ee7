"""ROS 1 bags, ROS 2 recordings and MCAP files, read by rosbags."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from toolkit.data.importing.folders import TIMES
from toolkit.data.importing.recording import Importer, Recording, Shot, library, pinhole_frame
from toolkit.data.importing.ros_messages import depth_of, lens_of, pose_of, rgb_of, seconds
from toolkit.data.importing.ros_tf import Pose, Tree
from toolkit.data.importing.settings import HandEye, pose
from toolkit.data.importing.trajectory import Trajectory, nearest
from toolkit.errors import ToolkitError, suggest
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Float, Frame

_TF = ("/tf", "/tf_static")


class RosConfig(PluginConfig):
    """Settings of `Ros`."""

    color: str = Field("/camera/color/image_raw", description="topic of colour images, raw or compressed")
    depth: str = Field(
        "/camera/aligned_depth_to_color/image_raw", description="topic of depth aligned to them, raw or compressed"
    )
    info: str = Field("/camera/color/camera_info", description="topic of the colour camera's CameraInfo")
    rectified: bool = Field(False, description="colour and depth are rectified, so that P of CameraInfo is theirs")
    pose: str | None = Field(None, description="topic of poses of `hand_eye`'s body; /tf where it is left out")
    world: str = Field("base_link", description="the world's frame in /tf")
    camera: str | None = Field(
        None, description="the body's frame in /tf; where it is left out, the frame that colour images are stamped with"
    )
    hand_eye: HandEye | None = None
    tolerance: float = Field(TIMES, gt=0, description="seconds that stamps may lie apart")


class Ros(Plugin[RosConfig], Importer):
    """Colour, aligned depth, CameraInfo and poses from a recording of ROS 1 (.bag) or ROS 2 (folder, .mcap, .db3).

    Poses come from /tf, or from a topic of PoseStamped, PoseWithCovarianceStamped, TransformStamped or Odometry, which
    needs `hand_eye`: the colour camera's pose on the body that the topic speaks of. All are interpolated between
    stamps of headers. Images without depth or pose within the tolerance are left out. Depth of 16 bits is in
    millimetres, of floats in metres (REP 118).
    """

    stage, name = "import kind", "ros"

    def read(self, source: Path) -> Recording:
        config, bag = self.config, _Bag(source)
        if config.pose is not None and config.hand_eye is None:
            raise ToolkitError(
                f'the topic {config.pose} gives poses of some body; --set "hand_eye=X Y Z QX QY QZ QW" says how the '
                "colour camera sits on it (0 0 0 0 0 0 1 where it speaks of the camera itself, in OpenCV's axes)"
            )
        T_body_camera = np.eye(4) if config.hand_eye is None else pose(config.hand_eye, "hand_eye")
        infos = [message for _, _, message in bag.messages([config.info])]
        if not infos:
            raise ToolkitError(f"the topic {config.info} has no message")
        colors = [(seconds(m.header.stamp), m.header.frame_id, at) for _, at, m in bag.messages([config.color])]
        depths = sorted((seconds(m.header.stamp), at) for _, at, m in bag.messages([config.depth]))
        if not colors:
            raise ToolkitError(f"the topic {config.color} has no message")
        bodies = _bodies(bag, config, sorted({frame for _, frame, _ in colors}))
        stamps = [stamp for stamp, _ in depths]
        shots: list[Shot] = []
        times: dict[int, tuple[int, int | None]] = {}
        for index, (stamp, frame, at) in enumerate(colors):
            body = bodies[frame](stamp)
            near = nearest(stamps, stamp, config.tolerance)
            if body is not None:
                shots.append(Shot(index, f"{stamp:.6f}", body @ T_body_camera, near is not None))
                times[index] = (at, None if near is None else depths[near][1])
        left = len(colors) - len(shots)
        if not shots:
            raise ToolkitError(
                f"no image has a pose within {config.tolerance:g} s; are poses and images stamped by one clock?"
            )
        K, distortion = lens_of(infos[0], config.rectified)

        def load(chosen: Sequence[Shot]) -> list[Frame]:
            rgb = {at: rgb_of(m) for at, m in bag.at(config.color, [times[s.index][0] for s in chosen])}
            wanted = [at for shot in chosen if (at := times[shot.index][1]) is not None]
            depth: dict[int | None, Float] = {at: depth_of(m) for at, m in bag.at(config.depth, wanted)}
            return [
                pinhole_frame(s, rgb[times[s.index][0]], depth.get(times[s.index][1]), K, distortion) for s in chosen
            ]

        notes = (f"{left} images have no pose within {config.tolerance:g} s: left out",) if left else ()
        return Recording(tuple(shots), load, notes=notes)


class _Bag:
    """A recording whose messages are read again whenever they are asked for."""

    def __init__(self, source: Path) -> None:
        self._source = source
        self._rosbags = library("rosbags.highlevel", "ros", "the import kind 'ros'")
        self._stores = library("rosbags.typesys", "ros", "the import kind 'ros'")

    def messages(self, topics: Sequence[str], *, needed: bool = True) -> Iterator[tuple[str, int, Any]]:
        """(topic, time of recording in nanoseconds, message) of topics; raises ToolkitError where one is unknown."""
        yield from self._read(topics, None, None, needed)

    def at(self, topic: str, times: Sequence[int]) -> Iterator[tuple[int, Any]]:
        """(time, message) of those messages of a topic that were recorded at these times."""
        for time in sorted(set(times)):
            for _, at, message in self._read([topic], time, time + 1, True):
                yield at, message

    def _read(
        self, topics: Sequence[str], start: int | None, stop: int | None, needed: bool
    ) -> Iterator[tuple[str, int, Any]]:
        store = self._stores.get_typestore(self._stores.Stores.LATEST)
        try:
            with self._rosbags.AnyReader([self._source], default_typestore=store) as reader:
                for topic in topics if needed else ():
                    if topic not in reader.topics:
                        raise ToolkitError(
                            f"'{self._source}' has no topic {topic}{suggest(topic, list(reader.topics))}"
                        )
                connections = [c for c in reader.connections if c.topic in topics]
                if not connections:
                    return
                for connection, at, data in reader.messages(connections, start=start, stop=stop):
                    yield connection.topic, at, reader.deserialize(data, connection.msgtype)
        except (self._rosbags.AnyReaderError, OSError, ValueError, KeyError) as error:
            said = " ".join(str(error).split())
            raise ToolkitError(f"'{self._source}' is no recording of ROS that can be read: {said}") from error


def _bodies(bag: _Bag, config: RosConfig, frames: Sequence[str]) -> dict[str, Pose]:
    """By frame that colour images are stamped with: the body's pose in the world at a time."""
    if config.pose is not None:
        found = [(seconds(m.header.stamp), pose_of(m)) for _, _, m in bag.messages([config.pose])]
        if not found:
            raise ToolkitError(f"the topic {config.pose} has no message")
        trajectory = Trajectory(*zip(*found, strict=True))
        return dict.fromkeys(frames, lambda stamp: trajectory.at(stamp, config.tolerance))
    tree = Tree((topic == _TF[1], message) for topic, _, message in bag.messages(_TF, needed=False))
    return {frame: tree.pose(config.world, config.camera or frame, config.tolerance) for frame in frames}
