"""Recordings of other tools, written with their libraries from a known capture, come in as that capture."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from written import edit

from toolkit.data.bop import load_capture
from toolkit.data.importing import IMPORTERS
from toolkit.data.importing.choosing import Frames
from toolkit.data.importing.trajectory import Trajectory
from toolkit.data.importing.writing import Goal, import_capture
from toolkit.errors import ToolkitError
from toolkit.geometry import invert, make_transform
from toolkit.plugin_kit.conformance.raycast import K
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame

INTRINSICS = f"{K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]}"
FRAMES = (*current_frames(), goal_frame())
GOAL = len(FRAMES) - 1
GL = np.diag([1.0, -1.0, -1.0, 1.0])
HAND_EYE = make_transform(Rotation.from_euler("xyz", [0.1, -0.2, 1.5]).as_matrix(), np.array([0.03, -0.01, 0.06]))
"""Poses are written of a flange, so that the hand-eye transform is needed."""


def quaternion(T) -> list[float]:
    return [*T[:3, 3].tolist(), *Rotation.from_matrix(T[:3, :3]).as_quat().tolist()]


def told(T) -> str:
    return " ".join(map(repr, quaternion(T)))


def write_color(path: Path, frame) -> str:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), frame.rgb[..., ::-1])
    return path.name


def units(frame, per_metre: float):
    """Depth as a camera stores it; a goal image has none."""
    depth = np.zeros(frame.rgb.shape[:2]) if frame.depth is None else frame.depth.astype(np.float64)
    return np.rint(depth * per_metre).astype(np.uint16)


def write_depth(path: Path, frame, per_metre: float = 1000) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), units(frame, per_metre))


def imported(kind, source, out, goal=str(GOAL), frames=None, **settings):
    recording = IMPORTERS.create(kind, settings).read(source)
    import_capture(recording, out, Goal(goal), Frames(frames))
    return load_capture(out)


def is_the_same(capture, depth_m: float, poses: float = 1e-9) -> None:
    """Every pixel, pose and depth is the original's: pixels exactly, depth to half a unit of the file."""
    assert [f.index for f in capture.current] == list(range(GOAL)) and capture.goal.index == GOAL
    for frame, known in zip((*capture.current, capture.goal), FRAMES, strict=True):
        np.testing.assert_array_equal(frame.rgb, known.rgb)
        np.testing.assert_allclose(frame.camera.K, known.camera.K, atol=1e-9)
        np.testing.assert_allclose(frame.camera.T_world_camera, known.camera.T_world_camera, atol=poses)
        if frame.depth is not None:
            np.testing.assert_allclose(frame.depth, known.depth, atol=depth_m / 2 + 1e-6)


# TUM: three text files.


@pytest.fixture
def tum(tmp_path):
    root = tmp_path / "tum"
    rgb, depth, poses = ["# colour"], [], ["# time tx ty tz qx qy qz qw"]
    for i, frame in enumerate(FRAMES):
        rgb.append(f"{100 + i}.000 rgb/{write_color(root / f'rgb/{i}.png', frame)}")
        write_depth(root / f"depth/{i}.png", frame, 5000)
        depth.append(f"{100 + i}.010 depth/{i}.png")
        poses.append(f"{100 + i}.000 {told(frame.camera.T_world_camera)}")
    for name, lines in (("rgb", rgb), ("depth", depth), ("groundtruth", poses)):
        (root / f"{name}.txt").write_text("\n".join(lines))
    return root


def test_tum(tum, tmp_path):
    is_the_same(imported("tum", tum, tmp_path / "out", intrinsics=INTRINSICS), depth_m=1 / 5000)


def test_tum_images_without_a_pose_or_depth_in_time_are_left_out(tum, tmp_path):
    lines = (tum / "groundtruth.txt").read_text().replace("101.000", "101.030", 1)
    (tum / "groundtruth.txt").write_text(lines)
    (tum / "depth.txt").write_text((tum / "depth.txt").read_text().replace("102.010", "102.500"))
    recording = IMPORTERS.create("tum", {"intrinsics": INTRINSICS}).read(tum)
    assert [(s.index, s.has_depth) for s in recording.shots] == [(0, True), (2, False), (3, True), (4, True)]
    assert recording.notes == ("1 images have no pose within 0.02 s: left out",)
    import_capture(recording, tmp_path / "out", Goal("rgb/4.png"), Frames())
    assert [f.index for f in load_capture(tmp_path / "out").current] == [0, 3]
    with pytest.raises(ToolkitError, match="stamped by one clock"):
        IMPORTERS.create("tum", {"intrinsics": INTRINSICS, "tolerance": 1e-9}).read(_shifted(tum))


def _shifted(tum):
    (tum / "groundtruth.txt").write_text((tum / "groundtruth.txt").read_text().replace("\n10", "\n20"))
    return tum


def test_poses_between_two_stamps_are_interpolated():
    a, b = np.eye(4), make_transform(Rotation.from_euler("z", 1.0).as_matrix(), np.array([0.2, 0, 0]))
    trajectory = Trajectory([2.0, 1.0], [b, a])
    half = trajectory.at(1.5, 0.6)
    np.testing.assert_allclose(half[:3, 3], [0.1, 0, 0])
    np.testing.assert_allclose(Rotation.from_matrix(half[:3, :3]).as_euler("xyz"), [0, 0, 0.5], atol=1e-12)
    assert trajectory.at(1.5, 0.4) is None
    np.testing.assert_array_equal(trajectory.at(2.1, 0.2), b)
    np.testing.assert_array_equal(trajectory.at(1.0, 0.2), a)


# Open3D and Redwood.


@pytest.fixture
def open3d(tmp_path):
    root = tmp_path / "open3d"
    log = []
    for i, frame in enumerate(FRAMES):
        # Without padding: 10 comes after 9.
        write_color(root / f"color/{i + 7}.png", frame)
        write_depth(root / f"depth/{i + 7}.png", frame)
        log += [f"{i} {i} {i + 1}", *(" ".join(map(repr, row)) for row in frame.camera.T_world_camera.tolist())]
    (root / "scene").mkdir()
    (root / "scene/trajectory.log").write_text("\n".join(log) + "\n")
    stored = {"width": 320, "height": 240, "intrinsic_matrix": K.T.ravel().tolist()}
    (root / "camera_intrinsic.json").write_text(json.dumps(stored))
    return root


def test_open3d(open3d, tmp_path):
    is_the_same(imported("open3d", open3d, tmp_path / "out"), depth_m=1e-3)


def test_open3d_says_what_is_missing(open3d, tmp_path):
    (open3d / "camera_intrinsic.json").unlink()
    with pytest.raises(ToolkitError, match="intrinsics=FX FY CX CY"):
        imported("open3d", open3d, tmp_path / "out")
    is_the_same(imported("open3d", open3d, tmp_path / "out", intrinsics=INTRINSICS), depth_m=1e-3)
    (open3d / "depth/9.png").unlink()
    with pytest.raises(ToolkitError, match="it has 5 and 4"):
        imported("open3d", open3d, tmp_path / "other", intrinsics=INTRINSICS)


# nerfstudio and Polycam: OpenGL's axes.


@pytest.fixture
def nerfstudio(tmp_path):
    root = tmp_path / "nerf"
    frames = []
    for i, frame in enumerate(FRAMES):
        entry = {"file_path": f"images/{write_color(root / f'images/f_{i}.png', frame)}"}
        entry["transform_matrix"] = (frame.camera.T_world_camera @ GL).tolist()
        if frame.depth is not None:
            write_depth(root / f"depths/f_{i}.png", frame)
            entry["depth_file_path"] = f"depths/f_{i}.png"
        frames.append(entry)
    camera = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2] + 0.5, "cy": K[1, 2] + 0.5, "w": 320, "h": 240}
    (root / "transforms.json").write_text(json.dumps({"camera_model": "OPENCV", **camera, "k1": 0, "frames": frames}))
    return root


def test_nerfstudio(nerfstudio, tmp_path):
    is_the_same(imported("nerfstudio", nerfstudio, tmp_path / "out", goal="f_4"), depth_m=1e-3)


def test_nerfstudio_lens_scale_and_depth_of_low_resolution(nerfstudio, tmp_path):
    def change(data):
        data.update(k1=-0.1, p1=0.01, applied_scale=2.0)
        for frame in data["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] *= 4
        path = nerfstudio / data["frames"][0]["depth_file_path"]
        small = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::2, ::2]
        assert cv2.imwrite(str(path), small)

    edit(nerfstudio / "transforms.json", change)
    capture = imported("nerfstudio", nerfstudio, tmp_path / "out", scale=0.5)
    for frame, known in zip(capture.current, FRAMES, strict=False):
        np.testing.assert_allclose(frame.camera.T_world_camera, known.camera.T_world_camera, atol=1e-9)
    straight = cv2.undistort(FRAMES[0].rgb, K, np.array([-0.1, 0, 0.01, 0]))
    assert np.abs(capture.current[0].rgb.astype(int) - straight)[40:-40, 40:-40].mean() < 1
    seen = capture.current[0].depth[100:140, 140:180]
    assert (seen > 0).all() and abs(np.median(seen) - np.median(FRAMES[0].depth[100:140, 140:180])) < 0.005


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.update(camera_model="OPENCV_FISHEYE"), "undistort its pictures first"),
        (lambda d: d.pop("fl_x"), "fl_x: Field required"),
        (lambda d: d.update(w=300), "is 320x240, but its camera says 300x240"),
        (lambda d: d["frames"][0].update(transform_matrix=np.diag([2.0, 1, 1, 1]).tolist()), "not rigid"),
        (lambda d: d.pop("frames"), "lists no frames"),
    ],
)
def test_nerfstudio_says_what_is_wrong(nerfstudio, tmp_path, change, said):
    edit(nerfstudio / "transforms.json", change)
    with pytest.raises(ToolkitError, match=said):
        imported("nerfstudio", nerfstudio, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_polycam(tmp_path):
    root = tmp_path / "polycam/keyframes"
    (root / "corrected_cameras").mkdir(parents=True)
    for i, frame in enumerate(FRAMES):
        T = frame.camera.T_world_camera @ GL
        camera = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "width": 320, "height": 240}
        camera |= {f"t_{r}{c}": T[r, c] for r in range(3) for c in range(4)}
        (root / f"corrected_cameras/{1000 + i}.json").write_text(json.dumps({**camera, "blur_score": 1.0}))
        write_color(root / f"corrected_images/{1000 + i}.png", frame)
        if frame.depth is not None:
            write_depth(root / f"depth/{1000 + i}.png", frame)
    is_the_same(imported("polycam", tmp_path / "polycam", tmp_path / "out", goal="1004"), depth_m=1e-3)


# COLMAP, written by pycolmap.


@pytest.mark.parametrize("binary", [True, False])
def test_colmap(tmp_path, binary):
    pycolmap = pytest.importorskip("pycolmap")
    root, model, scale = tmp_path / "colmap", pycolmap.Reconstruction(), 0.37
    params = [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, 0, 0, 0, 0]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model="OPENCV", width=320, height=240, params=params, camera_id=1)
    )
    for i, frame in enumerate(FRAMES):
        T = invert(frame.camera.T_world_camera)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(T[:3, :3]), T[:3, 3] / scale)
        image = pycolmap.Image(name=write_color(root / f"images/{i}.png", frame), camera_id=1, image_id=i + 1)
        model.add_image_with_trivial_frame(image, pose)
        if frame.depth is not None:
            write_depth(root / f"depth/{i}.png", frame)
    (root / "sparse/0").mkdir(parents=True)
    (model.write_binary if binary else model.write_text)(str(root / "sparse/0"))
    is_the_same(imported("colmap", root, tmp_path / "out", scale=scale), depth_m=1e-3)
    with pytest.raises(ToolkitError, match="'scale'"):
        IMPORTERS.create("colmap", {})
