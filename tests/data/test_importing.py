"""Recordings of other tools, written with their libraries from a known capture, come in as that capture."""

from __future__ import annotations

import shutil
import struct
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from recorded import (
    COLOR,
    DEPTH,
    FRAMES,
    GOAL,
    HAND_EYE,
    INFO,
    INTRINSICS,
    STAMPS,
    TF_MESSAGE,
    TOPICS,
    Bag,
    flange,
    imported,
    told,
    units,
    write_bop,
    write_colmap,
    write_color,
    write_nerfstudio,
    write_open3d,
    write_pixels,
    write_polycam,
    write_realsense,
    write_ros,
    write_tum,
)
from scipy.spatial.transform import Rotation
from written import edit, small_capture

from toolkit.data.bop import load_capture
from toolkit.data.importing import IMPORTERS
from toolkit.data.importing.choosing import Frames, find, spread
from toolkit.data.importing.folders import picture
from toolkit.data.importing.recorder import record_capture
from toolkit.data.importing.recording import Recording, Shot, library
from toolkit.data.importing.streams import Pixels
from toolkit.data.importing.trajectory import Trajectory
from toolkit.data.importing.writing import Goal, import_capture
from toolkit.errors import ToolkitError
from toolkit.geometry import make_transform, rotation_z
from toolkit.plugin_kit.conformance.raycast import NOW, THEN, K
from toolkit.plugin_kit.conformance.scene import goal_frame


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
    return write_tum(tmp_path / "tum").source


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
    return write_open3d(tmp_path / "open3d").source


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
    return write_nerfstudio(tmp_path / "nerf").source


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
    source = write_polycam(tmp_path / "polycam").source
    is_the_same(imported("polycam", source, tmp_path / "out", goal="1004"), depth_m=1e-3)


# COLMAP, written by pycolmap.


@pytest.mark.parametrize("binary", [True, False])
def test_colmap(tmp_path, binary):
    recorded = write_colmap(tmp_path / "colmap", binary=binary)
    is_the_same(imported("colmap", recorded.source, tmp_path / "out", **recorded.settings), depth_m=1e-3)
    with pytest.raises(ToolkitError, match="'scale'"):
        IMPORTERS.create("colmap", {})


# ROS, written by rosbags.

KINDS_OF_BAGS = ("bag", "sqlite3", "mcap")


@pytest.mark.parametrize("kind", KINDS_OF_BAGS)
def test_ros_with_a_topic_of_poses_and_a_hand_eye_transform(kind, tmp_path):
    recorded = write_ros(tmp_path / "ros", kind=kind)
    source, settings = recorded.source, recorded.settings
    is_the_same(imported("ros", source, tmp_path / "out", **settings), depth_m=1e-3)
    with pytest.raises(ToolkitError, match="hand_eye=X Y Z"):
        imported("ros", source, tmp_path / "other", **TOPICS, pose="/arm")
    with pytest.raises(
        ToolkitError, match="nothing of the topic /cam/color/image_rw; did you mean '/cam/color/image_raw'"
    ):
        imported("ros", source, tmp_path / "other", **{**settings, "color": "/cam/color/image_rw"})


@pytest.fixture(params=KINDS_OF_BAGS)
def bag(request, tmp_path):
    pytest.importorskip("rosbags")
    return Bag(tmp_path / ("ros.bag" if request.param == "bag" else "ros"), request.param)


def test_ros_with_tf(bag, tmp_path):
    """world <- base <- flange <- optical, the flange's transform told before and after each image."""
    name = TF_MESSAGE
    base = make_transform(rotation_z(0.7)[:3, :3], np.array([1.0, 0.5, 0.2]))
    with bag:
        write_pixels(bag)
        for topic, parent, child, T in (
            ("/tf_static", "world", "base", base),
            ("/tf_static", "flange", "optical", HAND_EYE),
        ):
            bag.write(topic, STAMPS[0], name, bag.make(name, [bag.transform(0, parent, child, T)]))
        for ns, frame in zip(STAMPS, FRAMES, strict=True):
            for around in (-8_000_000, 8_000_000):
                drift = make_transform(np.eye(3), np.array([around * 1e-10, 0, 0]))
                moved = bag.transform(ns + around, "base", "flange", drift @ flange(frame))
                bag.write("/tf", ns + around, name, bag.make(name, [moved]))
    is_the_same(imported("ros", bag.writer.path, tmp_path / "out", **TOPICS, world="base"), depth_m=1e-3, poses=1e-7)
    capture = imported("ros", bag.writer.path, tmp_path / "world", **TOPICS, world="world")
    np.testing.assert_allclose(capture.goal.camera.T_world_camera, base @ goal_frame().camera.T_world_camera, atol=1e-7)
    with pytest.raises(ToolkitError, match="no frame 'bse'; did you mean 'base'"):
        imported("ros", bag.writer.path, tmp_path / "other", **TOPICS, world="bse")


def test_ros_compressed_topics(tmp_path):
    pytest.importorskip("rosbags")
    name, pose_name = "sensor_msgs/msg/CompressedImage", "geometry_msgs/msg/TransformStamped"
    with Bag(tmp_path / "ros", "mcap") as bag:
        for ns, frame in zip(STAMPS, FRAMES, strict=True):
            bag.camera(INFO, ns)
            png = cv2.imencode(".png", frame.rgb[..., ::-1])[1]
            bag.write(COLOR, ns, name, bag.make(name, bag.header(ns, "optical"), "bgr8; png compressed", png.ravel()))
            depth = units(frame, 1000)
            if ns == STAMPS[0]:  # floats, quantised in inverse depth
                a, b = 10_000.0, 1.0
                depth = np.where(depth > 0, np.rint(a / np.maximum(frame.depth, 0.5) + b), 0).astype(np.uint16)
                said, head = "32FC1; compressedDepth png", struct.pack("<iff", 0, a, b)
            else:
                said, head = "16UC1; compressedDepth", bytes(12)
            data = np.frombuffer(head + cv2.imencode(".png", depth)[1].tobytes(), np.uint8)
            bag.write(DEPTH, ns, name, bag.make(name, bag.header(ns, "optical"), said, data))
            bag.write("/eye", ns, pose_name, bag.transform(ns, "base", "optical", frame.camera.T_world_camera))
    path, settings = bag.writer.path, {**TOPICS, "pose": "/eye", "hand_eye": "0 0 0 0 0 0 1"}
    is_the_same(imported("ros", path, tmp_path / "out", **settings), depth_m=1e-3)


def test_what_is_no_recording_of_ros_or_has_no_poses_is_named(tmp_path):
    pytest.importorskip("rosbags")
    (tmp_path / "x.bag").write_bytes(b"#ROSBAG V2.0 but not really")
    with Bag(tmp_path / "no_tf", "mcap") as bag:
        write_pixels(bag)
    with pytest.raises(ToolkitError, match="has no /tf; name a topic of poses"):
        imported("ros", tmp_path / "no_tf", tmp_path / "out", **TOPICS)
    (whole,) = (tmp_path / "no_tf").glob("*.mcap")
    (tmp_path / "half.mcap").write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    for source in ("x.bag", "nowhere", "half.mcap"):
        with pytest.raises(ToolkitError, match="is no recording of ROS that can be read"):
            imported("ros", tmp_path / source, tmp_path / "out")


# RealSense, recorded by pyrealsense2 from a device of its own that has no hardware.


def seen_by_both(capture):
    """Aligning widens what is near by a pixel; everywhere else, depth is as it was."""
    for frame, known in zip(capture.current, FRAMES, strict=False):
        assert (np.abs(frame.depth - known.depth) < 1e-4)[known.depth > 0].mean() > 0.9
        np.testing.assert_array_equal(frame.rgb, known.rgb)
        np.testing.assert_allclose(frame.camera.K, known.camera.K, atol=1e-4)
        np.testing.assert_allclose(frame.camera.T_world_camera, known.camera.T_world_camera, atol=1e-9)


@pytest.mark.slow  # the library's playback leaves frames out on a busy machine
def test_realsense(tmp_path):
    recorded = write_realsense(tmp_path / "realsense")
    capture = imported("realsense", recorded.source, tmp_path / "out", **recorded.settings)
    assert [f.index for f in capture.current] == [0, 1, 2, 3]
    seen_by_both(capture)
    arm = Path(recorded.settings["poses"])
    arm.write_text("\n".join(line.replace("100", "900", 1) for line in arm.read_text().splitlines()))
    with pytest.raises(ToolkitError, match=r"its frames are stamped 1000\.000 s to 1002\.000 s"):
        imported("realsense", recorded.source, tmp_path / "other", **recorded.settings)


class Played:
    """In a camera's place: gives every frame once."""

    def frames(self):
        return iter(FRAMES)

    def pixels(self, frame):
        return Pixels(frame.rgb, FRAMES[0].depth if frame.depth is None else frame.depth, K, ())


def test_record_takes_a_picture_for_every_pose(tmp_path, monkeypatch):
    monkeypatch.setattr("toolkit.data.importing.recorder._STALE", 0)
    lines = [f"{'goal ' if i == GOAL else ''}{told(flange(frame))}\n" for i, frame in enumerate(FRAMES)]
    assert record_capture(Played(), [*lines, "\n"], HAND_EYE, tmp_path / "out") == 4
    capture = load_capture(tmp_path / "out")
    seen_by_both(capture)
    np.testing.assert_array_equal(capture.goal.rgb, goal_frame().rgb)
    for told_lines, said in (
        (lines[:2], "got 0 and 2"),
        (lines[-1:], "got 1 and 0"),
        (["1 2 3"], "pose 0 must be"),
        ([*lines, lines[0]], "the camera gave no frame for pose 5"),
    ):
        with pytest.raises(ToolkitError, match=said):
            record_capture(Played(), told_lines, HAND_EYE, tmp_path / "other")
    with pytest.raises(ToolkitError, match="is there already"):
        record_capture(Played(), lines, HAND_EYE, tmp_path / "out")


# A scene of a BOP dataset: truth and models come along.


@pytest.fixture
def bop(tmp_path):
    return write_bop(tmp_path / "dataset").source.parent


def bop_pair(bop, out, **settings):
    importer = IMPORTERS.create("bop", settings)
    notes = import_capture(importer.read(bop / "000001"), out, Goal("0", importer.read(bop / "000002")), Frames())
    return load_capture(out), notes


def test_two_bop_scenes_of_the_same_objects_are_a_pair_with_truth(bop, tmp_path):
    capture, notes = bop_pair(bop, tmp_path / "out")
    original = load_capture(small_capture(tmp_path / "own"))
    assert notes == () and sorted(capture.truth) == sorted(original.truth)
    for instance, known in original.truth.items():
        np.testing.assert_allclose(capture.truth[instance].T_goal_current, known.T_goal_current, atol=1e-9)
        assert capture.truth[instance].model.name == known.model.name
        np.testing.assert_array_equal(capture.truth[instance].model.box_size, known.model.box_size)
    for frame, known in zip((*capture.current, capture.goal), (*original.current, original.goal), strict=True):
        np.testing.assert_array_equal(frame.rgb, known.rgb)
        np.testing.assert_allclose(frame.camera.T_world_camera, known.camera.T_world_camera, atol=1e-12)
        assert frame.true_masks.keys() == known.true_masks.keys()
        assert all((mask == known.true_masks[i]).all() for i, mask in frame.true_masks.items())
        if frame.depth is not None:
            np.testing.assert_array_equal(frame.depth, known.depth)


def test_an_object_is_the_world_of_bop_scenes_that_have_none(bop, tmp_path):
    """Object 3 then has not moved, and the others have, as seen from it."""
    for scene in ("000001", "000002"):
        edit(
            bop / scene / "scene_camera.json", lambda data: [e.pop(f"cam_{k}_w2c") for e in data.values() for k in "Rt"]
        )
    with pytest.raises(ToolkitError, match="cam_R_w2c is missing"):
        bop_pair(bop, tmp_path / "out")
    capture, _ = bop_pair(bop, tmp_path / "out", world=3)
    shift = {number: np.subtract(then[0], now[0]) for number, (now, then) in enumerate(zip(NOW, THEN, strict=True), 1)}
    for number, true in capture.truth.items():
        np.testing.assert_allclose(true.T_goal_current[:3, 3], shift[number] - shift[3], atol=1e-9)
        np.testing.assert_allclose(true.T_goal_current[:3, :3], np.eye(3), atol=1e-9)


def test_a_bop_scene_without_models_has_no_truth(bop, tmp_path):
    shutil.rmtree(bop.parent / "models")
    capture, notes = bop_pair(bop, tmp_path / "out")
    assert capture.truth is None and capture.goal.true_masks is None
    assert notes == ("scene_gt.json, mask_visib/ or models_info.json is not there: the capture has no truth",)


# Which images are taken, and how they lie.


def test_a_picture_is_turned_as_exif_says_only_where_its_camera_is(tmp_path):
    rgb = FRAMES[0].rgb
    stored = Image.fromarray(rgb)
    exif = stored.getexif()
    exif[0x0112] = 6  # the top of the scene is at the right
    stored.save(tmp_path / "turned.png", exif=exif)
    np.testing.assert_array_equal(picture(tmp_path / "turned.png", (240, 320)), rgb)
    np.testing.assert_array_equal(picture(tmp_path / "turned.png", (320, 240)), np.rot90(rgb, -1))
    with pytest.raises(ToolkitError, match="its size does not tell"):
        picture(tmp_path / "turned.png")
    with pytest.raises(ToolkitError, match="is 320x240, but its camera says 100x200"):
        picture(tmp_path / "turned.png", (200, 100))


def path_of(count: int) -> Recording:
    """Shots on a straight path, each 1 cm on, that stands still at its end."""
    places = [make_transform(np.eye(3), np.array([min(i, count // 2) / 100, 0, 0])) for i in range(count)]
    shots = tuple(Shot(i, f"left/{i:04d}.png", T, has_depth=i % 10 != 9) for i, T in enumerate(places))
    return Recording(shots, lambda chosen: [])


def test_frames_are_spread_over_the_path_unless_they_are_named():
    recording = path_of(100)
    goal = find(recording, "0050")

    def chosen(named=None, every=None):
        return [shot.index for shot in Frames(named, every).choose(recording, goal)]

    spaced = np.diff([min(i, 50) for i in chosen()])
    assert len(chosen()) == 8 and spaced.min() >= 6 and spaced.max() <= 13
    assert chosen("3,left/0007.png,0012") == [3, 7, 12]
    assert chosen("95:") == [95, 96, 97, 98] and chosen(":3,5") == [0, 1, 2, 5]
    assert chosen("10:40", 10) == [10, 21, 32]
    assert 50 not in chosen("48:53")
    with pytest.raises(ToolkitError, match="no image with depth is left"):
        chosen("9,19")
    with pytest.raises(ToolkitError, match="no image '101' in the recording; its images are 'left/0000"):
        chosen("101")
    standing = replace(recording, shots=recording.shots[60:80])
    assert len(spread(standing.shots, 8)) == 1


def test_a_goal_of_its_own_is_a_picture_from_a_known_place(tum, tmp_path):
    recording = IMPORTERS.create("tum", {"intrinsics": INTRINSICS}).read(tum)
    write_color(tmp_path / "goal.png", goal_frame())
    with pytest.raises(ToolkitError, match="has no pose of its own; --goal-camera"):
        import_capture(recording, tmp_path / "out", Goal(str(tmp_path / "goal.png")), Frames())
    import_capture(recording, tmp_path / "out", Goal(str(tmp_path / "goal.png"), camera="0"), Frames(":4"))
    capture = load_capture(tmp_path / "out")
    np.testing.assert_array_equal(capture.goal.rgb, goal_frame().rgb)
    np.testing.assert_allclose(capture.goal.camera.T_world_camera, FRAMES[0].camera.T_world_camera, atol=1e-9)
    assert [f.index for f in capture.current] == [0, 1, 2, 3]
    with pytest.raises(ToolkitError, match="is there already; name a new folder"):
        import_capture(recording, tmp_path / "out", Goal("4"), Frames())


@pytest.mark.parametrize(
    ("kind", "module"), [("colmap", "pycolmap"), ("ros", "rosbags"), ("realsense", "pyrealsense2")]
)
def test_a_library_that_is_missing_is_named_with_its_extra(kind, module, tmp_path, monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 0 1")
    (tmp_path / "file").touch()
    settings = {"colmap": {"scale": 1.0}, "ros": {}, "realsense": {"poses": str(tmp_path / "poses.txt")}}[kind]
    with pytest.raises(ToolkitError, match=rf"needs {module}: pip install 'rearrange-toolkit\[{kind}\]'"):
        IMPORTERS.create(kind, settings).read(tmp_path / "file")


def test_a_library_whose_own_libraries_the_system_lacks_is_not_to_be_installed_again(tmp_path, monkeypatch):
    (tmp_path / "linked.py").write_text("raise ImportError('libusb-1.0.so.0: cannot open shared object file')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ToolkitError, match=r"a camera needs linked, which is installed .*\(libusb-1\.0\.so\.0: cannot"):
        library("linked", "realsense", "a camera")
