"""What people really bring: hand-made JSON, pictures of all types and names, distortion, EXIF, odd depth, own masks."""

from __future__ import annotations

import json
import shutil
from io import BytesIO

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from written import TRUTH_FILES, edit, edit_cameras, rewrite, small_capture

from toolkit.data.bop import load_capture, load_models, write_capture
from toolkit.data.bop.images import read_color, read_labels, turned
from toolkit.data.bop.lens import Lens
from toolkit.errors import ToolkitError
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame
from toolkit.types import Camera, Frame


@pytest.fixture
def folder(tmp_path):
    return small_capture(tmp_path / "capture")


@pytest.fixture
def bare(tmp_path):
    """The same without truth."""
    return small_capture(tmp_path / "capture", truth=False)


def same_pictures(capture) -> None:
    for frame, known in zip((*capture.current, capture.goal), (*current_frames(), goal_frame()), strict=True):
        np.testing.assert_array_equal(frame.rgb, known.rgb)
        if known.depth is not None:
            np.testing.assert_allclose(frame.depth, known.depth, atol=5.1e-5)


# Hand-made JSON. Every value below is tried under every key.

WRONG = {
    "null": None,
    "a text": "640",
    "an empty list": [],
    "an object": {"fx": 1},
    "true": True,
    "not a number": float("nan"),
    "infinite": float("inf"),
    "a list of texts": ["1"] * 9,
    "too many numbers": [1.0] * 17,
}
NEEDED = {"cam_K", "cam_R_w2c", "cam_t_w2c", "depth_scale"}
CAMERA_KEYS = (*sorted(NEEDED), "width", "height", "cam_dist")
ALLOWED = {("cam_dist", "an empty list")}


def refusal(capture) -> str:
    with pytest.raises(ToolkitError) as error:
        load_capture(capture)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("key", CAMERA_KEYS)
def test_a_wrong_value_in_scene_camera_is_named_with_file_image_and_key(folder, key, wrong):
    edit(folder / "current/scene_camera.json", lambda data: data["2"].update({key: WRONG[wrong]}))
    if (key, wrong) in ALLOWED:
        assert load_capture(folder).notes == ()
        return
    said = refusal(folder)
    assert f"current/scene_camera.json', image 2: {key} must be " in said


@pytest.mark.parametrize("key", sorted(NEEDED))
def test_a_missing_key_is_named_with_what_it_is(folder, key):
    edit(folder / "current/scene_camera.json", lambda data: data["2"].pop(key))
    assert f"image 2: {key} is missing; it is " in refusal(folder)


@pytest.mark.parametrize(
    ("file", "key", "said"),
    [
        ("current/scene_gt.json", "obj_id", "image 1, object 0: obj_id must be"),
        ("current/scene_gt.json", "inst_id", "image 1, object 0: inst_id must be"),
        ("current/scene_gt.json", "cam_R_m2c", "image 1, object 0: cam_R_m2c must be"),
        ("current/scene_gt.json", "T_world_model", "image 1, object 0: T_world_model must be"),
        ("models_info.json", "diameter", "object 1: diameter must be"),
        ("models_info.json", "min_y", "object 1: min_y must be"),
        ("models_info.json", "size_z", "object 1: size_z must be"),
        ("models_info.json", "symmetries_discrete", "object 1: symmetries_discrete must be"),
        ("models_info.json", "symmetries_continuous", "object 1: symmetries_continuous must be"),
    ],
)
@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_value_about_objects_is_named_too(folder, file, key, said, wrong):
    if key.startswith("symmetries") and wrong == "an empty list":
        return
    of = (lambda data: data["1"][0]) if "gt" in file else (lambda data: data["1"])
    edit(folder / file, lambda data: of(data).update({key: WRONG[wrong]}))
    assert f"{file}', {said}" in refusal(folder)


KEYS = {
    "a name": ("frame_0", "is no image id"),
    "a sign": ("-1", "is no image id"),
    "a plus": ("+1", "is no image id"),
    "an underscore": ("1_0", "is no image id"),
    "another script's digit": ("١", "is no image id"),
    "too large": ("99999999999999", "is no image id"),
    "the same id, padded": ("01", "are the same image id; remove one"),
}


@pytest.mark.parametrize("case", KEYS)
@pytest.mark.parametrize("file", ["scene_camera.json", "scene_gt.json"])
def test_keys_that_are_no_ids(folder, file, case):
    key, said = KEYS[case]
    edit(folder / "current" / file, lambda data: data.update({key: data["1"]}))
    answer = refusal(folder)
    assert said in answer and file in answer


SHAPES = {
    "t 3x1": lambda e: e.update(cam_t_w2c=[[v] for v in e["cam_t_w2c"]]),
    "K 3x3": lambda e: e.update(cam_K=[e["cam_K"][i : i + 3] for i in (0, 3, 6)]),
    "K 9x1": lambda e: e.update(cam_K=[[v] for v in e["cam_K"]]),
    "whole floats": lambda e: e.update(width=float(e["width"])),
    "no size": lambda e: [e.pop("width"), e.pop("height")],
}


@pytest.mark.parametrize("case", SHAPES)
def test_numbers_may_be_nested(folder, case):
    edit_cameras(folder / "current", SHAPES[case])
    same_pictures(load_capture(folder))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-32"])
def test_a_byte_order_mark_is_no_error(folder, encoding):
    path = folder / "current/scene_camera.json"
    path.write_bytes(path.read_text().encode(encoding))
    same_pictures(load_capture(folder))


MALFORMED = {
    "one key twice": ('{"0": {}, "0": {}}', 'the key "0" stands in it twice'),
    "cut off": ('{"0": {', "is not readable JSON"),
    "a list": ("[1]", "must be a JSON object keyed by image id"),
    "an entry in a list": ('{"0": [{}]}', "image 0: an object"),
    "empty": ("", "is not readable JSON"),
    "binary": ("\0\1\2", "is not readable JSON"),
    "nested without end": ("[" * 100_000, "is not readable JSON"),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_json_of_another_form(folder, case):
    text, said = MALFORMED[case]
    (folder / "current/scene_camera.json").write_text(text)
    assert said in refusal(folder)


def test_unknown_keys_are_named_once_whatever_their_images(folder):
    edit_cameras(folder / "current", lambda entry: entry.update(cam_D=[0.1], exposure=3))
    (note,) = load_capture(folder).notes
    assert "current/scene_camera.json': 'cam_D', 'exposure' are not known, and not used" in note and "cam_dist" in note


def every_object(folder, change):
    for scene in ("current", "goal"):
        edit(folder / scene / "scene_gt.json", lambda d: [change(e) for entries in d.values() for e in entries])


TRUTH = {
    "an image is not listed": (
        lambda f: edit(f / "current/scene_gt.json", lambda d: d.pop("1")),
        "current/scene_gt.json' lists no image 1, which scene_camera.json does",
    ),
    "no pose": (
        lambda f: every_object(f, lambda e: [e.pop("T_world_model"), e.pop("cam_R_m2c")]),
        "cam_R_m2c and cam_t_m2c are missing",
    ),
    "one instance twice": (
        lambda f: every_object(f, lambda e: e.update(inst_id=4)),
        "inst_id 4 stands there twice",
    ),
    "an instance for some": (
        lambda f: edit(f / "goal/scene_gt.json", lambda d: d["0"][1].pop("inst_id")),
        "some objects have an inst_id and some have none",
    ),
    "an object without a model": (
        lambda f: edit(f / "models_info.json", lambda d: d.pop("2")),
        "obj_id 2 is not in models_info.json",
    ),
    "an axis of no direction": (
        lambda f: edit(
            f / "models_info.json",
            lambda d: d["2"].update(symmetries_continuous=[{"axis": [0, 0, 0], "offset": [0, 0, 0]}]),
        ),
        "symmetries_continuous must be",
    ),
    "a symmetry that is not rigid": (
        lambda f: edit(f / "models_info.json", lambda d: d["2"].update(symmetries_discrete=[[2.0] * 16])),
        "models_info.json': object 2: every discrete symmetry must be a rigid transform",
    ),
}


@pytest.mark.parametrize("case", TRUTH)
def test_truth_that_does_not_fit_together(folder, case):
    damage, said = TRUTH[case]
    damage(folder)
    assert said in refusal(folder)


def test_an_axis_need_not_be_of_length_1(folder):
    edit(
        folder / "models_info.json",
        lambda d: d["2"].update(symmetries_continuous=[{"axis": [0, 0, 5], "offset": [0, 1000, 0]}]),
    )
    np.testing.assert_allclose(load_models(folder / "models_info.json")[2].continuous_axes, [[0, 0, 1, 0, 1, 0]])


# Pictures


@pytest.mark.parametrize("suffix", [".png", ".PNG", ".tif", ".TIFF", ".bmp", ".webp"])
def test_lossless_pictures_of_any_type_and_name_are_the_same(folder, suffix):
    lossless = (cv2.IMWRITE_WEBP_QUALITY, 101) if suffix == ".webp" else ()
    for path in [*folder.glob("*/rgb/*.png")]:
        new = rewrite(path, suffix, *lossless)
        new.rename(new.with_name(f"{int(new.stem)}{suffix}"))
    same_pictures(load_capture(folder))


@pytest.mark.parametrize("suffix", [".jpg", ".jpeg", ".JPG"])
def test_jpegs_are_decoded_as_opencv_does(folder, suffix):
    path = rewrite(folder / "goal/rgb/000000.png", suffix)
    expected = cv2.imread(str(path))[..., ::-1]
    np.testing.assert_array_equal(load_capture(folder).goal.rgb, expected)


def test_more_columns_than_three_and_fewer_are_read_as_colour(tmp_path):
    rgb = np.random.default_rng(0).integers(0, 255, (6, 8, 3), np.uint8)
    path = tmp_path / "a.png"
    Image.fromarray(np.dstack([rgb, np.full((6, 8), 9, np.uint8)])).save(path)
    np.testing.assert_array_equal(read_color(path)[0], rgb)
    Image.fromarray(rgb[..., 0]).save(path)
    np.testing.assert_array_equal(read_color(path)[0], np.repeat(rgb[..., :1], 3, axis=2))
    Image.fromarray(rgb[..., 0].astype(np.uint16)).save(path)
    with pytest.raises(ToolkitError, match="one number a pixel, as depth does"):
        read_color(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("trailer", [b"\0" * 40, b"dhav\x10\x20\0\0", b"SEFHk\0\0\0SEFT", None])
def test_bytes_after_the_end_marker_are_no_damage_and_a_cut_is(folder, suffix, trailer):
    path = folder / "goal/rgb/000000.png"
    path = rewrite(path, suffix) if suffix != ".png" else path
    data = path.read_bytes()
    path.write_bytes(data + (data if trailer is None else trailer))
    load_capture(folder)
    path.write_bytes(data[: len(data) * 2 // 3])
    assert f"000000{suffix}' is truncated or not an image" in refusal(folder)


NEAR = {
    "a second suffix": (
        lambda rgb: (rgb / "000001.png").rename(rgb / "1.jpeg.txt"),
        "rgb/000001.png' is missing; '1.jpeg.txt' is there, but only files in .png .jpg",
    ),
    "a word before": (
        lambda rgb: (rgb / "000001.png").rename(rgb / "frame_0001.png"),
        "'frame_0001.png' is there: rename it to '000001.png'",
    ),
    "numbers from 4": (lambda rgb: (rgb / "000000.png").rename(rgb / "000004.png"), "holds the images 1, 2, 3, 4"),
    "twice": (lambda rgb: shutil.copy(rgb / "000001.png", rgb / "1.png"), "holds image 1 twice: '000001.png' and"),
    "no folder": (shutil.rmtree, "there is no such folder"),
    "an empty folder": (lambda rgb: [path.unlink() for path in rgb.iterdir()], "the folder is empty"),
}


@pytest.mark.parametrize("case", NEAR)
def test_the_near_miss_is_named(folder, case):
    change, said = NEAR[case]
    change(folder / "current/rgb")
    assert said in refusal(folder)


def test_the_only_goal_picture_may_be_what_was_meant(folder):
    (folder / "goal/rgb/000000.png").rename(folder / "goal/rgb/goal.png")
    assert "'goal.png' is there: rename it to '000000.png'" in refusal(folder)


def test_pictures_that_no_camera_lists_are_mentioned(folder):
    shutil.copy(folder / "current/rgb/000001.png", folder / "current/rgb/7.png")
    assert "holds pictures that scene_camera.json does not list: not used (image 7)" in load_capture(folder).notes[0]


# EXIF


def store_turned(path, orientation):
    """Store a picture so that EXIF turns it upright again."""
    rgb = np.asarray(Image.open(path).convert("RGB"))
    stored = next(
        image
        for image in (turned(rgb, back) for back in range(1, 9))
        if np.array_equal(turned(image, orientation), rgb)
    )
    path.unlink()
    exif = Image.Exif()
    exif[0x0112] = orientation
    data = BytesIO()
    Image.fromarray(stored).save(data, "PNG", exif=exif)
    path.write_bytes(data.getvalue())


@pytest.mark.parametrize("sized", [True, False])
@pytest.mark.parametrize("orientation", [5, 6, 7, 8])
def test_pictures_are_turned_where_their_size_says_that_cameras_are_too(bare, orientation, sized):
    store_turned(bare / "goal/rgb/000000.png", orientation)
    if not sized:
        edit_cameras(bare / "goal", lambda entry: [entry.pop("width"), entry.pop("height")])
    capture = load_capture(bare)
    np.testing.assert_array_equal(capture.goal.rgb, goal_frame().rgb)
    assert f"EXIF orientation {orientation} are turned" in capture.notes[0]


@pytest.mark.parametrize("sized", [True, False])
def test_pictures_stay_as_stored_where_cameras_are_of_the_sensor(bare, sized):
    rgb = goal_frame().rgb
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(rgb).save(bare / "goal/rgb/000000.png", exif=exif)
    if not sized:
        edit_cameras(bare / "goal", lambda entry: [entry.pop("width"), entry.pop("height")])
    capture = load_capture(bare)
    np.testing.assert_array_equal(capture.goal.rgb, rgb)
    assert "EXIF orientation 6 are not turned" in capture.notes[0]


@pytest.mark.parametrize("orientation", [2, 3, 4])
def test_what_a_size_cannot_tell_is_refused(bare, orientation):
    store_turned(bare / "goal/rgb/000000.png", orientation)
    assert f"EXIF orientation {orientation}, and its size does not tell" in refusal(bare)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_turning_is_pillows(orientation):
    from PIL import ImageOps

    rgb = np.random.default_rng(0).integers(0, 255, (4, 6, 3), np.uint8)
    picture = Image.fromarray(rgb)
    picture.getexif()[0x0112] = orientation
    np.testing.assert_array_equal(turned(rgb, orientation), np.asarray(ImageOps.exif_transpose(picture)))


@pytest.mark.parametrize("orientation", range(1, 9))
def test_tiffs_are_read_as_they_are_stored(tmp_path, orientation):
    rgb = np.random.default_rng(0).integers(0, 255, (4, 6, 3), np.uint8)
    Image.fromarray(rgb).save(tmp_path / "a.tif", tiffinfo={0x0112: orientation})
    stored, stated = read_color(tmp_path / "a.tif")
    assert stated == orientation
    np.testing.assert_array_equal(stored, rgb)


# Depth


def store_depth(folder, suffix, values, scale):
    """Replace every depth image by values(metres) in a file of another type, and state the unit."""
    frames = {int(path.stem): path for path in folder.glob("current/depth/*.png")}
    for frame in current_frames():
        path = frames[frame.index].with_suffix(suffix)
        frames[frame.index].unlink()
        image = values(frame.depth)
        if suffix == ".npy":
            np.save(path, image)
        elif suffix == ".exr":
            exr = pytest.importorskip("OpenEXR")
            header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
            exr.File(header, {"Z": image}).write(str(path))
        else:
            Image.fromarray(image).save(path)
    edit_cameras(folder / "current", lambda entry: entry.update(depth_scale=scale))


DEPTHS = {
    "16-bit TIFF, tenths of millimetres": (".tif", lambda z: np.rint(z * 1e4).astype(np.uint16), 0.1),
    "16-bit PNG, tenths of millimetres": (".png", lambda z: np.rint(z * 1e4).astype(np.uint16), 0.1),
    "float TIFF, metres": (".TIFF", lambda z: z, 1000),
    "float NPY, metres": (".npy", lambda z: z.astype(np.float64), 1000),
    "float NPY, millimetres": (".npy", lambda z: z * 1000, 1),
    "float NPY with a last axis": (".npy", lambda z: z[..., None], 1000),
    "16-bit NPY": (".npy", lambda z: np.rint(z * 1e4).astype(np.uint16), 0.1),
    "float EXR, metres": (".exr", lambda z: z, 1000),
    "half EXR, metres": (".exr", lambda z: z.astype(np.float16), 1000),
}


@pytest.mark.parametrize("case", DEPTHS)
def test_depth_of_any_type_in_its_stated_unit(folder, case):
    suffix, values, scale = DEPTHS[case]
    store_depth(folder, suffix, values, scale)
    for frame, known in zip(load_capture(folder).current, current_frames(), strict=True):
        np.testing.assert_allclose(frame.depth, known.depth, atol=1e-3 if "half" in case else 5.1e-5)


@pytest.mark.parametrize(
    ("suffix", "values", "scale", "said"),
    [
        (".npy", lambda z: z, 0.1, "floats in metres need 1000"),
        (".tif", lambda z: z, 1, "floats in metres need 1000"),
        (".png", lambda z: np.rint(z * 1e3).astype(np.uint16), 1000, "whole millimetres need 1"),
        (".png", lambda z: (z * 100).astype(np.uint8), 0.1, "is it a picture made to be looked at?"),
        (".png", lambda z: np.repeat((z * 100).astype(np.uint8)[..., None], 3, axis=2), 1, "made to be looked at?"),
        (".npy", lambda z: z[:100], 1000, "is 320x100, but its colour image is 320x240; align depth"),
        (".npy", lambda z: z.astype(complex), 1000, "is complex128"),
    ],
)
def test_depth_that_cannot_be_in_that_unit_is_refused(folder, suffix, values, scale, said):
    store_depth(folder, suffix, values, scale)
    assert said in refusal(folder)


@pytest.mark.parametrize(
    ("value", "kind"), [(65535, np.uint16), (np.nan, np.float32), (np.inf, np.float32), (-1, np.float32)]
)
def test_what_is_no_length_was_not_measured(folder, value, kind):
    holes = np.zeros((240, 320), bool)
    holes[100:140, 50:90] = True
    scale = 0.1 if kind is np.uint16 else 1000
    store_depth(
        folder,
        ".npy",
        lambda z: np.where(holes, value, np.rint(z * 1e3 / scale) if scale < 1 else z).astype(kind),
        scale,
    )
    capture = load_capture(folder)
    assert capture.notes == ()
    for frame in capture.current:
        assert not frame.depth[holes].any() and frame.depth[~holes].any()


def test_a_far_plane_in_many_holes_was_not_measured_and_a_wall_was(folder):
    rng = np.random.default_rng(0)
    holes = cv2.dilate((rng.random((240, 320)) < 0.005).astype(np.uint8), np.ones((3, 3))).astype(bool)
    store_depth(folder, ".npy", lambda z: np.where(holes, np.float32(4), z), 1000)
    capture = load_capture(folder)
    assert "depth of 4 m" in capture.notes[0]
    assert not any(frame.depth[holes].any() for frame in capture.current)


def test_a_wall_is_kept(folder):
    wall = np.zeros((240, 320), bool)
    wall[:60] = True
    store_depth(folder, ".npy", lambda z: np.where(wall, np.float32(4), z), 1000)
    capture = load_capture(folder)
    assert capture.notes == () and all((frame.depth[wall] == 4).all() for frame in capture.current)


def test_a_frame_without_depth_is_left_out_by_name(folder):
    (folder / "current/depth/000002.png").unlink()
    capture = load_capture(folder)
    assert [frame.index for frame in capture.current] == [0, 1, 3]
    (note,) = capture.notes
    assert note.startswith("current frame 2 is left out: ") and "depth/000002.png' is missing" in note


def test_frames_that_measured_nothing_are_one_sentence(folder):
    for image in (1, 2):
        cv2.imwrite(str(folder / f"current/depth/{image:06d}.png"), np.zeros((240, 320), np.uint16))
    capture = load_capture(folder)
    assert [frame.index for frame in capture.current] == [0, 3]
    (note,) = capture.notes
    assert note == "current frames with depth of zero everywhere are left out: nothing was measured (images 1, 2)"


def test_several_frames_without_depth_are_two_sentences(folder):
    for image in (1, 2, 3):
        (folder / f"current/depth/{image:06d}.png").unlink()
    first, others = load_capture(folder).notes
    assert first.startswith("current frame 1 is left out: ")
    assert others.startswith("others without a depth image in ")
    assert others.endswith("are left out as well (images 2, 3)")


def test_no_depth_at_all_is_refused_with_the_near_miss(folder):
    (folder / "current/depth").rename(folder / "current/depths")
    assert "no current frame has depth: " in refusal(folder) and "there is no such folder" in refusal(folder)


@settings(max_examples=20, deadline=None)
@given(farthest=st.floats(0.5, 90), seed=st.integers(0, 99))
def test_depth_reads_back_however_far_it_reaches(tmp_path_factory, farthest, seed):
    rng = np.random.default_rng(seed)
    known = current_frames()[0]
    depth = (rng.random((240, 320)) * farthest).astype(np.float32)
    depth[depth < 0.01] = 0
    folder = tmp_path_factory.mktemp("far") / "capture"
    write_capture(folder, [Frame(0, known.rgb, known.camera, depth)], goal_frame())
    read = load_capture(folder).current[0].depth
    step = 1e-4 * 2 ** max(0, int(np.ceil(np.log2(depth.max() / 6.5534))))
    np.testing.assert_allclose(read, depth, atol=step / 2 + 1e-6)


# Lenses


def distorted(image, camera, coefficients, nearest):
    """The image as a lens would have taken it."""
    height, width = image.shape[:2]
    grid = np.stack(np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)), axis=-1)
    source = cv2.undistortPoints(grid.reshape(-1, 1, 2), camera.K, np.array(coefficients), P=camera.K)
    mode = cv2.INTER_NEAREST if nearest else cv2.INTER_CUBIC
    return cv2.remap(image, source.reshape(height, width, 2), None, mode)


@pytest.mark.parametrize("coefficients", [[-0.12, 0, 0, 0, 0], [0.1, -0.05, 0.002, -0.001]])
def test_stated_distortion_is_taken_out_of_pictures_depth_and_masks(folder, coefficients):
    for scene in ("current", "goal"):
        for path in (folder / scene).glob("*/*.png"):
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            nearest = path.parent.name != "rgb"
            cv2.imwrite(str(path), distorted(image, goal_frame().camera, coefficients, nearest))
        edit_cameras(folder / scene, lambda entry: entry.update(cam_dist=coefficients))
    capture = load_capture(folder)
    inner = np.s_[20:-20, 20:-20]
    for frame, known in zip(capture.current, current_frames(), strict=True):
        assert np.abs(frame.rgb[inner].astype(int) - known.rgb[inner]).mean() < 4
        off = np.abs(frame.depth[inner] - known.depth[inner])
        assert np.median(off[known.depth[inner] > 0]) < 0.003
        for number, mask in known.true_masks.items():
            both = (frame.true_masks[number] & mask).sum()
            assert both / (frame.true_masks[number] | mask).sum() > 0.9


def test_no_distortion_changes_no_byte(folder):
    edit_cameras(folder / "current", lambda entry: entry.update(cam_dist=[0, 0, 0, 0, 0]))
    same_pictures(load_capture(folder))


def test_coefficients_that_cannot_be_right_are_refused(folder):
    edit_cameras(folder / "goal", lambda entry: entry.update(cam_dist=[900.0, 0, 0, 0]))
    assert "goal/scene_camera.json', image 0: cam_dist leaves" in refusal(folder)


def test_a_lens_shows_the_border_where_the_picture_ends():
    camera = goal_frame().camera
    lens = Lens.of(camera.K, (0.3, 0.0, 0.0, 0.0), (240, 320), "here")
    assert lens is not None and not lens.inside.all()
    assert lens.color(np.full((240, 320, 3), 7, np.uint8)).min() == 7
    assert not lens.nearest(np.ones((240, 320), np.float32))[~lens.inside].any()


# A user's own masks


def label_images(folder, scene, numbers):
    """Turn a scene's masks into one label image per picture; `numbers` says which value an object has in an image."""
    for frame in current_frames() if scene == "current" else (goal_frame(),):
        labels = np.zeros((240, 320), np.uint8)
        for number, mask in frame.true_masks.items():
            labels[mask] = numbers(frame.index, number)
        Image.fromarray(labels).save(folder / f"{frame.index}.png")


def test_masks_without_truth_are_a_users_own(bare):
    capture = load_capture(bare)
    assert capture.truth is None and capture.goal.true_masks is None
    assert "--segmenter masks --goal-segmenter masks" in capture.notes[0]
    for frame, known in zip((*capture.current, capture.goal), (*current_frames(), goal_frame()), strict=True):
        own = [mask for _, mask in sorted(frame.own_masks.items())]
        np.testing.assert_array_equal(own, [mask for _, mask in sorted(known.true_masks.items())])


def test_masks_of_another_folder_as_label_images_win(folder, tmp_path):
    for scene in ("current", "goal"):
        (tmp_path / "masks" / scene).mkdir(parents=True)
        label_images(tmp_path / "masks" / scene, scene, lambda image, number: 10 * number)
    capture = load_capture(folder, tmp_path / "masks")
    assert set(capture.goal.own_masks) == {10, 20, 30} and set(capture.goal.true_masks) == {1, 2, 3}
    np.testing.assert_array_equal(capture.goal.own_masks[20], capture.goal.true_masks[2])
    assert capture.digest != load_capture(folder).digest


def test_a_palette_holds_labels_by_index(tmp_path):
    labels = np.array([[0, 1], [2, 1]], np.uint8)
    picture = Image.fromarray(labels, "P")
    picture.putpalette([0, 0, 0, 255, 0, 0, 0, 255, 0])
    picture.save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_labels(tmp_path / "a.png"), labels)
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (4, 4, 3), np.uint8)).save(tmp_path / "b.png")
    with pytest.raises(ToolkitError, match="is in colour"):
        read_labels(tmp_path / "b.png")


def test_masks_that_overlap_a_little_are_parted_and_a_lot_is_refused(bare):
    path = bare / "goal/mask_visib"
    large = cv2.imread(str(path / "000000_000000.png"), cv2.IMREAD_GRAYSCALE)
    y, x = np.nonzero(large)
    extra = np.zeros_like(large)
    extra[y[:5], x[:5]] = 255
    extra[:20, :20] = 255
    cv2.imwrite(str(path / "000000_000003.png"), extra)
    masks = load_capture(bare).goal.own_masks
    assert sum(mask.astype(int) for mask in masks.values()).max() == 1
    cv2.imwrite(str(path / "000000_000003.png"), large)
    assert "overlaps another one" in refusal(bare)


MASKS = {
    "another size": (lambda f: cv2.imwrite(str(f / "000000_000001.png"), np.ones((9, 9), np.uint8)), "is 9x9, but its"),
    "two of a kind": (lambda f: shutil.copy(f / "000000_000001.png", f / "0_1.png"), "show the same; keep one"),
    "labels and objects": (lambda f: shutil.copy(f / "000000_000001.png", f / "0.png"), "show the same; keep one"),
    "no label image": (
        lambda f: [
            [path.unlink() for path in f.iterdir()],
            Image.fromarray(np.arange(240 * 320).reshape(240, 320).astype(np.int32)).save(f / "0.tif"),
        ],
        "a label image has one per object",
    ),
}


@pytest.mark.parametrize("case", MASKS)
def test_masks_that_are_none(bare, case):
    change, said = MASKS[case]
    change(bare / "goal/mask_visib")
    assert said in refusal(bare)


def test_an_image_without_a_mask_shows_no_object_and_is_named(bare):
    for path in (bare / "current/mask_visib").glob("000002_*"):
        path.unlink()
    capture = load_capture(bare)
    assert capture.current[2].own_masks == {}
    assert "images are taken to show no object (image 2)" in capture.notes[0]


def test_a_folder_of_masks_needs_a_scene_and_masks(folder, tmp_path):
    with pytest.raises(ToolkitError, match="goal' holds no mask; they are label images"):
        (tmp_path / "empty/goal").mkdir(parents=True)
        load_capture(folder, tmp_path / "empty")
    with pytest.raises(ToolkitError, match="must hold current/ and goal/"):
        load_capture(folder, tmp_path / "nowhere")


def test_everything_written_reads_back_without_a_note(folder):
    capture = load_capture(folder)
    same_pictures(capture)
    assert capture.notes == () and len(capture.truth) == 3
    assert json.loads((folder / "current/scene_camera.json").read_text())["0"]["depth_scale"] == 0.1
    assert all((folder / name).exists() for name in TRUTH_FILES)
    assert isinstance(capture.goal.camera, Camera)
