from __future__ import annotations

import json
import shutil

import cv2
import numpy as np
import pytest

from toolkit.data.bop import load_capture, load_models
from toolkit.errors import ToolkitError
from toolkit.geometry import lift
from toolkit.results.metrics import pose_error


def edit(path, change):
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def test_a_written_capture_reads_back(capture):
    assert len(capture.current) == 4 and len(capture.truth) == 3
    assert capture.goal.depth is None
    for truth in capture.truth.values():
        error = pose_error(truth.T_goal_current, truth)
        assert (error.rotation_error_deg, error.translation_error_cm) == (0.0, 0.0)


def test_depth_masks_and_poses_agree(capture):
    """The lifted pixels of a mask lie in the box of the object they belong to."""
    for frame in capture.current:
        for instance, mask in frame.true_masks.items():
            truth = capture.truth[instance]
            y, x = np.nonzero(mask)
            world = lift(frame.camera.K, frame.camera.T_world_camera, np.stack([x, y], axis=1), frame.depth[y, x])
            local = (world - truth.T_world_current[:3, 3]) @ truth.T_world_current[:3, :3]
            low, high = truth.model.box_min - 0.004, truth.model.box_min + truth.model.box_size + 0.004
            assert ((local > low) & (local < high)).all(axis=1).mean() > 0.98


def test_the_digest_is_of_the_files(capture_copy):
    before = load_capture(capture_copy).digest
    assert load_capture(capture_copy).digest == before
    edit(capture_copy / "models_info.json", lambda d: next(iter(d.values())).update(diameter=1.0))
    assert load_capture(capture_copy).digest != before


def test_a_capture_without_truth_or_masks_is_fine(capture_copy):
    for scene in ("current", "goal"):
        (capture_copy / scene / "scene_gt.json").unlink()
        shutil.rmtree(capture_copy / scene / "mask_visib")
    capture = load_capture(capture_copy)
    assert capture.truth is None and capture.goal.true_masks is None


def test_bop_files_without_our_extra_keys_read_the_same(capture, capture_copy):
    for scene in ("current", "goal"):
        edit(
            capture_copy / scene / "scene_gt.json",
            lambda d: [e.pop(k) for entries in d.values() for e in entries for k in ("inst_id", "T_world_model")],
        )
    plain = {t.model.object_id: t for t in load_capture(capture_copy).truth.values()}
    for truth in capture.truth.values():
        np.testing.assert_allclose(plain[truth.model.object_id].T_goal_current, truth.T_goal_current, atol=1e-9)


def swap_sizes(folder):
    image = np.zeros((100, 100, 3), np.uint8)
    cv2.imwrite(str(folder / "current/rgb/000001.png"), image)


def truncate(folder):
    path = folder / "goal/rgb/000000.png"
    path.write_bytes(path.read_bytes()[:5000])


def zero_depth(folder):
    for path in (folder / "current/depth").glob("*.png"):
        cv2.imwrite(str(path), np.zeros((480, 640), np.uint16))


def overlap(folder):
    shutil.copy(folder / "goal/mask_visib/000000_000000.png", folder / "goal/mask_visib/000000_000001.png")


def camera(change):
    return lambda folder: edit(folder / "current/scene_camera.json", lambda d: change(d["1"]))


BAD = {
    "no goal": (lambda f: shutil.rmtree(f / "goal"), "goal/scene_camera.json' is missing"),
    "no depth folder": (lambda f: shutil.rmtree(f / "current/depth"), "depth/000000.png' is missing"),
    "no mask": (lambda f: (f / "goal/mask_visib/000000_000001.png").unlink(), "000000_000001.png' is missing"),
    "truncated image": (truncate, "000000.png' is truncated"),
    "image of another size": (swap_sizes, "is 100x100, but its camera says 640x480"),
    "depth all zero": (zero_depth, "zero everywhere"),
    "pose not finite": (camera(lambda c: c.update(cam_t_w2c=[float("nan"), 0, 0])), "image 1: cam_t_w2c must be"),
    "pose not rigid": (camera(lambda c: c.update(cam_R_w2c=[2, 0, 0, 0, 1, 0, 0, 0, 1])), "not rigid"),
    "not a pinhole": (camera(lambda c: c.update(cam_K=[600, 9, 320, 0, 600, 240, 0, 0, 1])), "not a pinhole"),
    "no intrinsics": (camera(lambda c: c.pop("cam_K")), "image 1: cam_K is missing"),
    "masks that overlap": (overlap, "overlaps another one"),
    "JSON that does not parse": (lambda f: (f / "goal/scene_camera.json").write_text("{"), "not readable JSON"),
    "no images": (lambda f: (f / "current/scene_camera.json").write_text("{}"), "lists no image"),
    "not a capture": (shutil.rmtree, "does not exist"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_captures_are_answered_with_the_file_and_the_reason(capture_copy, case):
    damage, said = BAD[case]
    damage(capture_copy)
    with pytest.raises(ToolkitError, match=said) as error:
        load_capture(capture_copy)
    assert "\n" not in str(error.value)


def test_models_info_with_a_missing_key_names_the_object(tmp_path):
    (tmp_path / "models_info.json").write_text('{"7": {"diameter": 100}}')
    with pytest.raises(ToolkitError, match="object 7"):
        load_models(tmp_path / "models_info.json")
