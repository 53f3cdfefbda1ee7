"""The little scene as recordings of every kind that is imported, each written with the library of its kind."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from written import edit, true_objects

from toolkit.data.bop import load_capture, write_capture
from toolkit.data.importing import IMPORTERS
from toolkit.data.importing.choosing import Frames as Chosen
from toolkit.data.importing.writing import Goal, import_capture
from toolkit.geometry import invert, make_transform
from toolkit.plugin_kit.conformance.raycast import K
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame
from toolkit.types import Float, Frame

FRAMES = (*current_frames(), goal_frame())
"""What is recorded: the current frames, and the goal as the last one."""

GOAL = len(FRAMES) - 1
INTRINSICS = f"{K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]}"
HAND_EYE = make_transform(Rotation.from_euler("xyz", [0.1, -0.2, 1.5]).as_matrix(), np.array([0.03, -0.01, 0.06]))
"""Poses are written of a flange, so that the hand-eye transform is needed."""

_GL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Recorded:
    """A recording, and what is to be said to import it.

    Attributes:
        source: the folder or file.
        settings: of its kind.
        goal: number of the goal image.
        of_goal: the recording that holds it, where that is another one.
    """

    source: Path
    settings: dict[str, Any] = field(default_factory=dict)
    goal: int = GOAL
    of_goal: Path | None = None


def imported(kind: str, source: Path, out: Path, goal: str = str(GOAL), frames: str | None = None, **settings: Any):
    """The capture that a recording becomes in the folder `out`."""
    import_capture(IMPORTERS.create(kind, settings).read(source), out, Goal(goal), Chosen(frames))
    return load_capture(out)


def quaternion(T: Float) -> list[float]:
    return [*T[:3, 3].tolist(), *Rotation.from_matrix(T[:3, :3]).as_quat().tolist()]


def told(T: Float) -> str:
    """A pose as text: x y z qx qy qz qw."""
    return " ".join(map(repr, quaternion(T)))


def flange(frame: Frame) -> Float:
    """(4, 4) pose of the body that carries the camera."""
    return frame.camera.T_world_camera @ invert(HAND_EYE)


def write_color(path: Path, frame: Frame) -> str:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), frame.rgb[..., ::-1])
    return path.name


def units(frame: Frame, per_metre: float):
    """Depth as a camera stores it; a goal image has none."""
    depth = np.zeros(frame.rgb.shape[:2]) if frame.depth is None else frame.depth.astype(np.float64)
    return np.rint(depth * per_metre).astype(np.uint16)


def write_depth(path: Path, frame: Frame, per_metre: float = 1000) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), units(frame, per_metre))


def write_tum(root: Path, frames: Sequence[Frame] = FRAMES) -> Recorded:
    """Three text files."""
    rgb, depth, poses = ["# colour"], [], ["# time tx ty tz qx qy qz qw"]
    for i, frame in enumerate(frames):
        rgb.append(f"{100 + i}.000 rgb/{write_color(root / f'rgb/{i}.png', frame)}")
        write_depth(root / f"depth/{i}.png", frame, 5000)
        depth.append(f"{100 + i}.010 depth/{i}.png")
        poses.append(f"{100 + i}.000 {told(frame.camera.T_world_camera)}")
    for name, lines in (("rgb", rgb), ("depth", depth), ("groundtruth", poses)):
        (root / f"{name}.txt").write_text("\n".join(lines))
    return Recorded(root, {"intrinsics": INTRINSICS})


def write_open3d(root: Path, frames: Sequence[Frame] = FRAMES) -> Recorded:
    """Open3D's and Redwood's: trajectory.log, and images that are paired by their order."""
    log = []
    for i, frame in enumerate(frames):
        # Without padding: 10 comes after 9.
        write_color(root / f"color/{i + 7}.png", frame)
        write_depth(root / f"depth/{i + 7}.png", frame)
        log += [f"{i} {i} {i + 1}", *(" ".join(map(repr, row)) for row in frame.camera.T_world_camera.tolist())]
    (root / "scene").mkdir()
    (root / "scene/trajectory.log").write_text("\n".join(log) + "\n")
    stored = {"width": 320, "height": 240, "intrinsic_matrix": K.T.ravel().tolist()}
    (root / "camera_intrinsic.json").write_text(json.dumps(stored))
    return Recorded(root)


def write_nerfstudio(root: Path, frames: Sequence[Frame] = FRAMES) -> Recorded:
    """transforms.json, in OpenGL's axes."""
    entries = []
    for i, frame in enumerate(frames):
        entry: dict[str, Any] = {"file_path": f"images/{write_color(root / f'images/f_{i}.png', frame)}"}
        entry["transform_matrix"] = (frame.camera.T_world_camera @ _GL).tolist()
        if frame.depth is not None:
            write_depth(root / f"depths/f_{i}.png", frame)
            entry["depth_file_path"] = f"depths/f_{i}.png"
        entries.append(entry)
    camera = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2] + 0.5, "cy": K[1, 2] + 0.5, "w": 320, "h": 240}
    (root / "transforms.json").write_text(json.dumps({"camera_model": "OPENCV", **camera, "k1": 0, "frames": entries}))
    return Recorded(root)


def write_polycam(root: Path, frames: Sequence[Frame] = FRAMES) -> Recorded:
    """A raw export's keyframes, in OpenGL's axes."""
    keyframes = root / "keyframes"
    (keyframes / "corrected_cameras").mkdir(parents=True)
    for i, frame in enumerate(frames):
        T = frame.camera.T_world_camera @ _GL
        camera = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "width": 320, "height": 240}
        camera |= {f"t_{r}{c}": T[r, c] for r in range(3) for c in range(4)}
        (keyframes / f"corrected_cameras/{1000 + i}.json").write_text(json.dumps({**camera, "blur_score": 1.0}))
        write_color(keyframes / f"corrected_images/{1000 + i}.png", frame)
        if frame.depth is not None:
            write_depth(keyframes / f"depth/{1000 + i}.png", frame)
    return Recorded(root)


def write_colmap(root: Path, frames: Sequence[Frame] = FRAMES, *, binary: bool = True) -> Recorded:
    """A reconstruction of some unit, written by pycolmap."""
    pycolmap = pytest.importorskip("pycolmap")
    model, scale = pycolmap.Reconstruction(), 0.37
    params = [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, 0, 0, 0, 0]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model="OPENCV", width=320, height=240, params=params, camera_id=1)
    )
    for i, frame in enumerate(frames):
        T = invert(frame.camera.T_world_camera)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(T[:3, :3]), T[:3, 3] / scale)
        image = pycolmap.Image(name=write_color(root / f"images/{i}.png", frame), camera_id=1, image_id=i + 1)
        model.add_image_with_trivial_frame(image, pose)
        if frame.depth is not None:
            write_depth(root / f"depth/{i}.png", frame)
    (root / "sparse/0").mkdir(parents=True)
    (model.write_binary if binary else model.write_text)(str(root / "sparse/0"))
    return Recorded(root, {"scale": scale})


STAMPS = [1_700_000_000_000_000_000 + i * 500_000_000 for i in range(len(FRAMES))]
COLOR, DEPTH, INFO = "/cam/color/image_raw", "/cam/depth/image_raw", "/cam/color/camera_info"
TOPICS = {"color": COLOR, "depth": DEPTH, "info": INFO}
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
_LATE_NS = 3_000_000


class Bag:
    """A recording that is being written, of one of three formats."""

    def __init__(self, path: Path, kind: str) -> None:
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.first = kind == "bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.first else Stores.ROS2_HUMBLE)
        if self.first:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF_MESSAGE))
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        self.writer = Writer1(path) if self.first else Writer2(path, version=9, storage_plugin=plugin)
        self.connections = {}

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *_):
        self.writer.close()

    def make(self, name: str, *values, **named):
        return self.store.types[name](*values, **named)

    def header(self, ns: int, frame: str):
        stamp = self.make("builtin_interfaces/msg/Time", ns // 10**9, ns % 10**9)
        numbered = (0,) if self.first else ()
        return self.make("std_msgs/msg/Header", *numbered, stamp, frame)

    def write(self, topic: str, ns: int, name: str, message) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, name, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.first else self.store.serialize_cdr
        self.writer.write(self.connections[topic], ns, serialize(message, name))

    def image(self, topic: str, ns: int, pixels, encoding: str, pad: int = 0) -> None:
        data = pixels.reshape(len(pixels), -1).view(np.uint8)
        data = np.pad(data, ((0, 0), (0, pad)))
        header = self.header(ns, "optical")
        message = self.make(
            "sensor_msgs/msg/Image", header, *pixels.shape[:2], encoding, 0, data.shape[1], data.ravel()
        )
        self.write(topic, ns + _LATE_NS, "sensor_msgs/msg/Image", message)

    def camera(self, topic: str, ns: int) -> None:
        roi = self.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        P = np.hstack([K, np.zeros((3, 1))])
        fields = [240, 320, "plumb_bob", np.zeros(5), K.ravel(), np.eye(3).ravel(), P.ravel(), 0, 0, roi]
        message = self.make("sensor_msgs/msg/CameraInfo", self.header(ns, "optical"), *fields)
        self.write(topic, ns, "sensor_msgs/msg/CameraInfo", message)

    def pose(self, T):
        at = self.make("geometry_msgs/msg/Point", *T[:3, 3].tolist())
        return self.make("geometry_msgs/msg/Pose", at, self.make("geometry_msgs/msg/Quaternion", *quaternion(T)[3:]))

    def transform(self, ns: int, parent: str, child: str, T):
        at = self.make("geometry_msgs/msg/Vector3", *T[:3, 3].tolist())
        turn = self.make("geometry_msgs/msg/Quaternion", *quaternion(T)[3:])
        inner = self.make("geometry_msgs/msg/Transform", at, turn)
        return self.make("geometry_msgs/msg/TransformStamped", self.header(ns, parent), child, inner)


def write_pixels(bag: Bag, frames: Sequence[Frame] = FRAMES) -> None:
    """The topics of a colour and a depth camera."""
    for ns, frame in zip(STAMPS, frames, strict=True):
        bag.camera(INFO, ns)
        bag.image(COLOR, ns, frame.rgb[..., ::-1].copy(), "bgr8", pad=4)
        bag.image(DEPTH, ns + 2_000_000, units(frame, 1000), "16UC1")


def write_ros(root: Path, frames: Sequence[Frame] = FRAMES, *, kind: str = "mcap") -> Recorded:
    """A recording with a topic of the arm's poses, written by rosbags."""
    pytest.importorskip("rosbags")
    name = "geometry_msgs/msg/PoseStamped"
    with Bag(root.with_suffix(".bag") if kind == "bag" else root, kind) as bag:
        write_pixels(bag, frames)
        for ns, frame in zip(STAMPS, frames, strict=True):
            bag.write("/arm", ns, name, bag.make(name, bag.header(ns, "base"), bag.pose(flange(frame))))
    return Recorded(bag.writer.path, {**TOPICS, "pose": "/arm", "hand_eye": told(HAND_EYE)})


def write_realsense(root: Path, frames: Sequence[Frame] = FRAMES) -> Recorded:
    """Recorded by pyrealsense2 from a device of its own that has no hardware, and the arm's poses beside it."""
    rs = pytest.importorskip("pyrealsense2", exc_type=ImportError)  # the system may lack libusb
    root.mkdir()
    device = rs.software_device()
    sensors, profiles = [], []
    for uid, (kind, format_, bytes_) in enumerate(
        ((rs.stream.depth, rs.format.z16, 2), (rs.stream.color, rs.format.rgb8, 3))
    ):
        sensor = device.add_sensor(kind.name)
        stream = rs.video_stream()
        stream.type, stream.index, stream.uid, stream.fps, stream.bpp, stream.fmt = kind, 0, uid, 30, bytes_, format_
        stream.width, stream.height = 320, 240
        intrinsics = rs.intrinsics()
        intrinsics.width, intrinsics.height, intrinsics.model = 320, 240, rs.distortion.none
        intrinsics.coeffs = [0.0] * 5
        intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        stream.intrinsics = intrinsics
        profiles.append(sensor.add_video_stream(stream).as_video_stream_profile())
        sensors.append(sensor)
    sensors[0].add_read_only_option(rs.option.depth_units, 1e-4)
    same = rs.extrinsics()
    same.rotation, same.translation = np.eye(3).ravel().tolist(), [0.0] * 3
    profiles[0].register_extrinsics_to(profiles[1], same)
    profiles[1].register_extrinsics_to(profiles[0], same)
    recorder, syncer = rs.recorder(str(root / "recorded.db3"), device), rs.syncer()
    recorded = recorder.query_sensors()
    for sensor, profile in zip(recorded, profiles, strict=True):
        sensor.open(profile)
        sensor.start(syncer)
    for number, frame in enumerate(frames):
        depth = units(frame if frame.depth is not None else frames[0], 1e4)
        for sensor, profile, pixels in zip(sensors, profiles, (depth, frame.rgb), strict=True):
            sent = rs.software_video_frame()
            sent.pixels, sent.stride, sent.bpp = pixels, pixels.strides[0], pixels.strides[1]
            sent.timestamp, sent.domain = 1e6 + 500.0 * number, rs.timestamp_domain.system_time
            sent.frame_number, sent.profile, sent.depth_units = number, profile, 1e-4
            sensor.on_video_frame(sent)
    for sensor in recorded:
        sensor.stop()
        sensor.close()
    del recorder, recorded, sensor
    arm = [f"{1000 + 0.5 * i} {told(flange(frame))}" for i, frame in enumerate(frames)]
    (root / "arm.txt").write_text("\n".join(arm))
    return Recorded(root / "recorded.db3", {"poses": str(root / "arm.txt"), "hand_eye": told(HAND_EYE)})


def write_bop(root: Path, frames: Sequence[Frame] = FRAMES) -> Recorded:
    """A dataset of two scenes, current and goal, with truth and models: test/000001, test/000002 and models/."""
    T_world_scene = frames[0].camera.T_world_camera @ invert(FRAMES[0].camera.T_world_camera)
    write_capture(root / "own", frames[:-1], frames[-1], true_objects(T_world_scene))
    for number, name in ((1, "current"), (2, "goal")):
        scene = shutil.copytree(root / "own" / name, root / f"test/{number:06d}")
        for key in ("T_world_model", "inst_id"):  # our own captures' keys
            edit(scene / "scene_gt.json", lambda data, key=key: [e.pop(key) for image in data.values() for e in image])
    (root / "models").mkdir()
    (root / "own/models_info.json").rename(root / "models/models_info.json")
    shutil.rmtree(root / "own")
    return Recorded(root / "test/000001", goal=frames[-1].index, of_goal=root / "test/000002")


WRITERS: dict[str, Callable[[Path, Sequence[Frame]], Recorded]] = {
    "bop": write_bop,
    "colmap": write_colmap,
    "nerfstudio": write_nerfstudio,
    "open3d": write_open3d,
    "polycam": write_polycam,
    "realsense": write_realsense,
    "ros": write_ros,
    "tum": write_tum,
}
"""By the kind that reads it."""
