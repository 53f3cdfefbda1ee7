"""ROS 1 bags, ROS 2 recordings and MCAP files, read by rosbags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import Field

from toolkit.data.importing.folders import TOLERANCE_S
from toolkit.data.importing.recording import Importer, Recording, Shot, pinhole_frame
from toolkit.data.importing.ros_bag import Bag
from toolkit.data.importing.ros_messages import depth_of, lens_of, rgb_of, seconds, stamped_pose
from toolkit.data.importing.ros_tf import Pose, Tree
from toolkit.data.importing.settings import HandEye, body_to_camera
from toolkit.data.importing.trajectory import Trajectory, nearest, without_pose
from toolkit.errors import ToolkitError
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Frame

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
    tolerance: float = Field(TOLERANCE_S, gt=0, description="seconds that stamps may lie apart")


class Ros(Plugin[RosConfig], Importer):
    """Colour, aligned depth, CameraInfo and poses from a recording of ROS 1 (.bag) or ROS 2 (folder, .mcap, .db3).

    Poses come from /tf, or from a topic of PoseStamped, PoseWithCovarianceStamped, TransformStamped or Odometry, which
    needs `hand_eye`: the colour camera's pose on the body that the topic speaks of. All are interpolated between
    stamps of headers. Images without depth or pose within the tolerance are left out. Depth of 16 bits is in
    millimetres, of floats in metres (REP 118).
    """

    stage, name = "import kind", "ros"

    def read(self, source: Path) -> Recording:
        config, bag = self.config, Bag(source)
        if config.pose is not None and config.hand_eye is None:
            raise ToolkitError(
                f'the topic {config.pose} gives poses of some body; --set "hand_eye=X Y Z QX QY QZ QW" says how the '
                "colour camera sits on it (0 0 0 0 0 0 1 where it speaks of the camera itself, in OpenCV's axes)"
            )
        T_body_camera = body_to_camera(config.hand_eye)
        found = bag.gather(
            {
                config.info: lambda message: message,
                config.color: lambda message: (seconds(message.header.stamp), message.header.frame_id),
                config.depth: lambda message: seconds(message.header.stamp),
                **({} if config.pose is None else {config.pose: stamped_pose}),
            },
            {name: lambda message: message for name in _TF if config.pose is None},
        )
        bodies = _bodies(found, config)
        depths = sorted((stamp, at) for at, stamp in found[config.depth])
        stamps = [stamp for stamp, _ in depths]
        shots: list[Shot] = []
        times: dict[int, tuple[int, int | None]] = {}
        for index, (at, (stamp, frame)) in enumerate(found[config.color]):
            body, near = bodies[frame](stamp), nearest(stamps, stamp, config.tolerance)
            if body is not None:
                shots.append(Shot(index, f"{stamp:.6f}", body @ T_body_camera, near is not None))
                times[index] = (at, None if near is None else depths[near][1])
        left = len(found[config.color]) - len(shots)
        if not shots:
            raise ToolkitError(
                f"no image has a pose within {config.tolerance:g} s; are poses and images stamped by one clock?"
            )
        K, distortion = lens_of(found[config.info][0][1], config.rectified)

        def load(chosen: Sequence[Shot]) -> list[Frame]:
            wanted = [times[shot.index] for shot in chosen]
            rgb = bag.pick(config.color, rgb_of, [at for at, _ in wanted])
            depth = bag.pick(config.depth, depth_of, [at for _, at in wanted if at is not None])
            return [
                pinhole_frame(shot, rgb[at], None if near is None else depth[near], K, distortion)
                for shot, (at, near) in zip(chosen, wanted, strict=True)
            ]

        return Recording(tuple(shots), load, notes=without_pose(left, config.tolerance))


def _bodies(found: Mapping[str, list[tuple[int, Any]]], config: RosConfig) -> dict[str, Pose]:
    """By frame that colour images are stamped with: the body's pose in the world at a time."""
    frames = sorted({frame for _, (_, frame) in found[config.color]})
    if config.pose is not None:
        trajectory = Trajectory(*zip(*(stamped for _, stamped in found[config.pose]), strict=True))
        return dict.fromkeys(frames, lambda stamp: trajectory.at(stamp, config.tolerance))
    if not any(found[topic] for topic in _TF):
        raise ToolkitError("the recording has no /tf; name a topic of poses with --set pose=TOPIC")
    tree = Tree((topic == _TF[1], message) for topic in _TF for _, message in found[topic])
    return {frame: tree.pose(config.world, config.camera or frame, config.tolerance) for frame in frames}
