from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest

from toolkit.data import noise
from toolkit.data.bop import load_capture
from toolkit.data.cameras import current_cameras, home_camera
from toolkit.data.conditions import Conditions
from toolkit.data.dataset import build_dataset, cached_dataset, read_dataset
from toolkit.data.layout import arrange, resting_poses
from toolkit.data.objects import load_object_set
from toolkit.data.source import open_capture
from toolkit.data.tabletop import TabletopConfig
from toolkit.errors import ToolkitError
from toolkit.geometry import rotation_angle
from toolkit.parallel import open_workers
from toolkit.sim.bullet import best_renderer

NO_EGL = pytest.mark.skipif(best_renderer() != "egl", reason="EGL does not load here")
SMALL = {"min_objects": 2, "max_objects": 3, "views": 2, "supersample": 1}


def files(folder):
    return {p.relative_to(folder): hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.rglob("*") if p.is_file()}


def test_a_scene_is_the_same_whatever_else_is_built(cache, tmp_path):
    config = TabletopConfig(scenes=3, seed=5, **SMALL)
    alone = build_dataset(config, tmp_path / "alone", cache)
    with open_workers(2) as workers:
        together = build_dataset(config.model_copy(update={"scenes": 2}), tmp_path / "together", cache, workers)
    for scene in ("000000", "000001"):
        assert files(alone / scene) == files(together / scene)
    assert files(alone / "000000") != files(alone / "000001")


def test_a_cached_dataset_grows_instead_of_starting_again(cache):
    built = []
    config = TabletopConfig(scenes=1, seed=6, **SMALL)
    folder = cached_dataset(config, cache)
    first = (folder / "000000/goal/rgb/000000.png").stat().st_mtime_ns
    more = cached_dataset(config.model_copy(update={"scenes": 2}), cache, None, lambda done, _: built.append(done))
    assert more == folder and built == [1, 2] and len(read_dataset(folder)) == 2
    assert (folder / "000000/goal/rgb/000000.png").stat().st_mtime_ns == first


def test_one_scene_of_a_cached_dataset_is_built_alone(cache):
    config = TabletopConfig(scenes=2, seed=7, **SMALL)
    capture = open_capture(config.model_dump(mode="json"), cache, 1)
    assert [folder.name for folder in read_dataset(capture.parent)] == ["000001"]
    before = files(capture)
    folder = cached_dataset(config, cache)
    assert capture == folder / "000001" and files(capture) == before and len(read_dataset(folder)) == 2


def test_dataset_json_says_how_it_was_made(dataset):
    made = json.loads((dataset / "dataset.json").read_text())
    assert made["renderer"] == "PyBullet TinyRenderer"
    assert made["config"]["seed"] == 5 and made["object_set"]["name"] == "procedural"


@pytest.mark.parametrize("limit", [0, 60, 180])
def test_objects_turn_within_the_limit_and_stay_on_the_table(cache, tmp_path, limit):
    config = TabletopConfig(scenes=1, rotation_deg=limit, seed=limit, **SMALL)
    capture = load_capture(build_dataset(config, tmp_path / "data", cache) / "000000")
    for truth in capture.truth.values():
        T = truth.T_goal_current
        assert np.degrees(rotation_angle(T[:3, :3])) <= limit + 1e-6
        np.testing.assert_allclose(T[2], [0, 0, 1, 0], atol=1e-9)


def test_arrangements_keep_their_distance(cache):
    rests = [resting_poses(asset)[0] for asset in load_object_set("procedural", cache).assets[:6]]
    placements = arrange(rests, [0.3] * 6, 0.6, 0.02, np.random.default_rng(0))
    for i, a in enumerate(placements):
        for b, rest in zip(placements[:i], rests[:i], strict=True):
            # Two footprints contain discs of their smallest support, which must be apart too.
            gap = np.hypot(a.x - b.x, a.y - b.y) - rests[i].support.min() - rest.support.min()
            assert gap >= 0.02


def test_a_table_that_is_too_small_is_said_to_be_so(cache):
    rests = [resting_poses(asset)[0] for asset in load_object_set("procedural", cache).assets[:9]]
    with pytest.raises(ToolkitError, match="does not hold these 9 objects"):
        arrange(rests, [0.0] * 9, 0.15, 0.01, np.random.default_rng(0))


def test_more_objects_than_there_are_is_an_error(cache, tmp_path):
    with pytest.raises(ToolkitError, match="max_objects is 5000, but 'procedural' has"):
        build_dataset(TabletopConfig(scenes=1, max_objects=5000), tmp_path / "data", cache)


def test_the_first_ring_view_is_the_home_view():
    cameras = current_cameras(Conditions(), "640x480", 8, np.random.default_rng(0))
    np.testing.assert_array_equal(cameras[0].T_world_camera, home_camera("640x480").T_world_camera)
    assert len({c.T_world_camera.tobytes() for c in cameras}) == 8


def test_the_d435_track_disturbs_what_it_says(cache, tmp_path):
    clean = TabletopConfig(scenes=1, seed=2, **SMALL)
    noisy = clean.model_copy(update={"track": "d435"})
    a = load_capture(build_dataset(clean, tmp_path / "clean", cache) / "000000")
    b = load_capture(build_dataset(noisy, tmp_path / "noisy", cache) / "000000")
    np.testing.assert_array_equal(a.truth[0].T_goal_current, b.truth[0].T_goal_current)
    assert (b.current[0].depth == 0).mean() > (a.current[0].depth == 0).mean()
    assert not np.array_equal(a.goal.rgb, b.goal.rgb)
    np.testing.assert_array_equal(a.goal.camera.T_world_camera, b.goal.camera.T_world_camera)


def test_axial_noise_grows_with_the_square_of_depth():
    rng = np.random.default_rng(0)
    spread = [np.std(noise.axial_noise(np.full((300, 300), z, np.float32), rng) - z) for z in (0.5, 1.0)]
    assert spread[1] / spread[0] == pytest.approx(4, rel=0.1)
    assert spread[1] == pytest.approx(noise.SUBPIXEL_RMS / (noise.FOCAL_PX * noise.BASELINE_M), rel=0.1)


def test_quantisation_steps_are_disparity_steps():
    stepped = np.unique(noise.quantize(np.linspace(0.9, 1.1, 2000, dtype=np.float32)))
    disparity = noise.FOCAL_PX * noise.BASELINE_M / stepped
    np.testing.assert_allclose(np.diff(disparity), -noise.DISPARITY_STEP_PX, rtol=1e-3)
    assert noise.quantize(np.zeros((2, 2), np.float32)).max() == 0


def test_a_folder_that_is_no_dataset_is_said_to_be_so(tmp_path):
    with pytest.raises(ToolkitError, match="does not exist"):
        read_dataset(tmp_path / "absent")
    with pytest.raises(ToolkitError, match="holds no capture"):
        read_dataset(tmp_path)


@pytest.mark.parametrize("renderer", ["tiny", pytest.param("egl", marks=NO_EGL)])
def test_recoloured_objects_are_rendered_in_their_own_colours(cache, tmp_path, renderer):
    config = TabletopConfig(scenes=1, seed=2, **SMALL | {"min_objects": 2, "max_objects": 2}, renderer=renderer)
    alike, other = (
        load_capture(build_dataset(config.model_copy(update={"lookalikes": kind}), tmp_path / kind, cache) / "000000")
        for kind in ("twins", "recolored")
    )
    shown = [c.goal.rgb[c.goal.true_masks[1]].mean(axis=0) for c in (alike, other)]
    assert np.abs(shown[0] - shown[1]).max() > 15
    unchanged = [c.goal.rgb[c.goal.true_masks[0]].mean(axis=0) for c in (alike, other)]
    np.testing.assert_allclose(*unchanged, atol=2)


def test_a_build_that_was_stopped_is_not_believed_and_goes_on(cache, tmp_path):
    config = TabletopConfig(scenes=2, seed=8, **SMALL)
    out = build_dataset(config, tmp_path / "data", cache)
    whole = files(out)
    (out / "000001").rename(out / ".000001.17.abcdef.tmp")
    with pytest.raises(ToolkitError, match=r"has 1 of the 2 scenes its dataset\.json speaks of") as error:
        read_dataset(out)
    assert "\n" not in str(error.value)
    with pytest.raises(ToolkitError, match="is not empty; name a new folder"):
        build_dataset(config.model_copy(update={"seed": 9}), out, cache)
    build_dataset(config, out, cache)
    assert [path.name for path in read_dataset(out)] == ["000000", "000001"]
    assert {name: sha for name, sha in files(out).items() if name.parts[0][0] != "."} == whole


def test_settings_that_did_not_work_can_be_mended_in_the_same_folder(cache, tmp_path):
    config = TabletopConfig(scenes=1, seed=8, **SMALL)
    with pytest.raises(ToolkitError, match="max_objects is 999, but"):
        build_dataset(config.model_copy(update={"max_objects": 999}), tmp_path, cache)
    build_dataset(config, tmp_path, cache)
    assert json.loads((tmp_path / "dataset.json").read_text())["config"]["max_objects"] == config.max_objects
    assert len(read_dataset(tmp_path)) == 1


def test_another_tools_list_is_not_written_over(cache, tmp_path):
    (tmp_path / "dataset.json").write_text('{"config": {}}')
    with pytest.raises(ToolkitError, match="is not empty; name a new folder"):
        build_dataset(TabletopConfig(scenes=1, **SMALL), tmp_path, cache)
    assert (tmp_path / "dataset.json").read_text() == '{"config": {}}'


def test_a_dataset_is_not_built_in_a_file(cache, tmp_path):
    (tmp_path / "scenes").write_text("mine")
    with pytest.raises(ToolkitError, match="scenes' is a file; name a folder"):
        build_dataset(TabletopConfig(scenes=1, **SMALL), tmp_path / "scenes", cache)
    assert (tmp_path / "scenes").read_text() == "mine"
