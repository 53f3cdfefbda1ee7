"""Recordings hold what they say: written, read back, and compared with what was to be shown."""

from __future__ import annotations

import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from usual import USUAL

from toolkit.data.objects import load_object_set
from toolkit.data.tabletop import TabletopConfig, draw_scene
from toolkit.errors import ToolkitError
from toolkit.geometry import make_transform, transform_points
from toolkit.harness.ablate import Ablation
from toolkit.harness.drive import drive
from toolkit.harness.experiment import Cell, expand, load_experiment
from toolkit.harness.runs import RunOptions
from toolkit.harness.view import open_viewer, view_capture, view_scene, worst_table
from toolkit.perception.database import Database
from toolkit.perception.fusion import Models, clouds, fuse
from toolkit.perception.regions import lift_segment
from toolkit.pictures.film import Film, record_poses
from toolkit.pictures.recording import record_scene
from toolkit.rearrangement.executors.kinematic import Kinematic
from toolkit.rearrangement.moves import PickPlace
from toolkit.results.rows import Row, best_cell, worst_rows
from toolkit.types import Failure, PoseEstimate, Segment


@pytest.fixture
def read():
    """Reads a recording: entity -> component -> what was logged last; skips where rerun is not installed."""
    chunk = pytest.importorskip("rerun.chunk")

    def read(path):
        found = {}
        for part in chunk.RrdReader(path).stream().to_chunks():
            batch = part.to_record_batch()
            of_entity = found.setdefault(part.entity_path, {})
            for field, column in zip(batch.schema, batch.columns, strict=True):
                of_entity[field.name.partition(":")[2] or field.name] = column.to_pylist()[-1]
        return found

    return read


@pytest.fixture(scope="module")
def known(capture):
    """The capture's database with true instances, and estimates of which the first is right, the last a failure."""
    regions = [(i, lift_segment(f, Segment(m))) for f in capture.current for i, m in sorted(f.true_masks.items())]
    instances = np.array([i for i, _ in regions])
    database = Database(
        capture.current, tuple(r for _, r in regions), instances, np.ones((len(regions), 1), np.float32)
    )
    masks = sorted(capture.goal.true_masks.items())
    motions = [capture.truth[i].T_goal_current for i, _ in masks]
    motions[1] = motions[1] @ make_transform(np.eye(3), np.array([0.1, 0, 0]))
    estimates = [
        PoseEstimate(k, Segment(mask), i, motions[k], confidence=0.875, ambiguity="hidden")
        for k, (i, mask) in enumerate(masks)
    ]
    lost = Failure("pnp", "no consensus")
    estimates[2] = PoseEstimate(2, Segment(masks[2][1]), masks[2][0], None, lost)
    return database, clouds(database, Models(database)), estimates


@pytest.fixture
def scene_file(capture, known, read, tmp_path):
    record_scene(tmp_path / "deep" / "scene.rrd", "a scene", capture, *known)
    return read(tmp_path / "deep" / "scene.rrd")


def test_frames_are_recorded_where_they_were_taken(capture, scene_file):
    for frame in capture.current:
        camera = scene_file[f"/current/frames/{frame.index:06d}"]
        T = frame.camera.T_world_camera
        # Rerun keeps matrices by columns.
        np.testing.assert_allclose(np.reshape(camera["mat3x3"], (3, 3)).T, T[:3, :3], atol=1e-6)
        np.testing.assert_allclose(np.ravel(camera["translation"]), T[:3, 3], atol=1e-6)
        K = np.reshape(camera["image_from_camera"], (3, 3)).T
        np.testing.assert_allclose(K - frame.camera.K, [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]], atol=1e-3)


def test_pictures_and_depth_are_those_of_the_frames(capture, scene_file):
    frame = capture.current[1]
    rgb = cv2.imdecode(blob(scene_file["/current/frames/000001/rgb"]), cv2.IMREAD_COLOR)[..., ::-1]
    assert np.abs(rgb.astype(float) - frame.rgb).mean() < 3
    logged = scene_file["/current/frames/000001/depth"]
    depth = cv2.imdecode(blob(logged), cv2.IMREAD_UNCHANGED) / logged["meter"][0]
    np.testing.assert_allclose(depth, frame.depth, atol=0.00026)
    goal = cv2.imdecode(blob(scene_file["/goal/camera/rgb"]), cv2.IMREAD_COLOR)[..., ::-1]
    assert np.abs(goal.astype(float) - capture.goal.rgb).mean() < 3


def blob(logged):
    return np.frombuffer(bytes(logged["blob"][0]), np.uint8)


def test_models_are_shown_where_they_are_and_where_they_are_taken_to_be(known, scene_file):
    database, _, estimates = known
    model = fuse(database, estimates[0].instance)
    now = scene_file[f"/current/instances/{estimates[0].instance}"]
    np.testing.assert_allclose(now["positions"], model.points, atol=1e-6)
    red = np.array(now["colors"], np.uint32) >> 24
    np.testing.assert_allclose(red, model.colors[:, 0], atol=0.51)
    then = scene_file["/goal/estimates/0"]
    np.testing.assert_allclose(
        then["positions"], transform_points(estimates[0].T_goal_current, model.points), atol=1e-6
    )


def test_the_truth_is_shown_as_boxes(capture, scene_file):
    for i, true in capture.truth.items():
        for side, T in (("current", true.T_world_current), ("goal", true.T_world_goal)):
            box = scene_file[f"/{side}/truth/{i}"]
            np.testing.assert_allclose(np.reshape(box["mat3x3"], (3, 3)).T, T[:3, :3], atol=1e-6)
            np.testing.assert_allclose(np.ravel(box["translation"]), transform_points(T, true.model.center), atol=1e-6)
            np.testing.assert_allclose(np.ravel(box["half_sizes"]), true.model.box_size / 2, atol=1e-6)
            assert box["labels"] == [true.model.name]


def test_what_is_said_of_every_object_is_written_on_it(capture, known, scene_file):
    names = [capture.truth[e.instance].model.name for e in known[-1]]
    labels = scene_file["/goal/camera/objects"]["labels"]
    assert labels == [f"0 {names[0]}: 0.88, hidden", f"1 {names[1]}: 0.88, hidden", f"2 {names[2]}: failed"]
    assert scene_file["/goal/estimates/0"]["labels"] == labels[:1]
    colors = scene_file["/goal/camera/objects"]["colors"]
    assert colors[0] != colors[1] == colors[2]
    failed = scene_file["/goal/estimates/2"]
    assert failed["reason"] == ["pnp: no consensus"] and "positions" not in failed
    (text,) = scene_file["/summary"]["text"]
    assert "1 of 3 objects right" in text
    assert "0.0 deg, 0.0 cm | 0.88 | hidden" in text and "10.0 cm" in text and "pnp: no consensus" in text


def test_a_capture_without_truth_is_recorded_too(capture, known, read, tmp_path):
    unknown = replace(capture, truth=None, goal=replace(capture.goal, true_masks=None))
    record_scene(tmp_path / "scene.rrd", "unknown", unknown, *known)
    found = read(tmp_path / "scene.rrd")
    assert not [entity for entity in found if "truth" in entity]
    assert found["/goal/camera/objects"]["labels"][0] == "0: 0.88, hidden"
    assert "objects right" not in found["/summary"]["text"][0]


def test_without_rerun_one_sentence_says_what_to_install(capture, known, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ToolkitError, match=r"pip install 'rearrange-toolkit\[view\]'"):
        record_scene(tmp_path / "scene.rrd", "a scene", capture, *known)


def test_a_recording_that_cannot_be_written_is_one_sentence(capture, known, tmp_path):
    pytest.importorskip("rerun")
    (tmp_path / "file").touch()
    with pytest.raises(ToolkitError, match="cannot be written"):
        record_scene(tmp_path / "file" / "scene.rrd", "a scene", capture, *known)


# Runs


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of two scenes in two cells."""
    folder = tmp_path_factory.mktemp("run")
    data = {
        "name": "small",
        "dataset": {"scenes": 2, "min_objects": 2, "max_objects": 2, "views": 3, "supersample": 1, "renderer": "tiny"},
        "pipeline": USUAL,
        "sweep": {"pipeline.views": ["all", 1]},
    }
    (folder / "small.yaml").write_text(yaml.safe_dump(data))
    return drive(Ablation(), load_experiment(str(folder / "small.yaml")), RunOptions(out=folder / "run"))


def test_a_scene_of_a_run_is_recorded_as_the_run_estimated_it(run, read):
    path = view_scene(run, 1, "views=1")
    found = read(path)
    assert path == run / "recordings" / "000001.rrd"
    assert frames_in(found) == {"000000"}
    assert "scene 1, views=1" in found["/summary"]["text"][0]
    path = view_scene(run, 1, "views=all", run / "mine.rrd")
    assert path == run / "mine.rrd" and frames_in(read(path)) == {"000000", "000001", "000002"}


def frames_in(found):
    return {entity.split("/")[3] for entity in found if entity.startswith("/current/frames/")}


def test_what_a_run_does_not_have_is_said(run, tmp_path):
    pytest.importorskip("rerun")
    with pytest.raises(ToolkitError, match="has no scene 9; it has 2, from 0 to 1"):
        view_scene(run, 9)
    with pytest.raises(ToolkitError, match="did you mean 'views=1'"):
        view_scene(run, 1, "view=1")
    with pytest.raises(ToolkitError, match="neither a run folder"):
        view_scene(tmp_path, 1)


def test_the_worst_cases_are_listed(run):
    assert worst_table(run, "views=1").columns[0].header == "scene"
    with pytest.raises(ToolkitError, match="has no cell 'x'"):
        worst_table(run, "x")


def test_worst_rows_come_without_motion_first_then_by_angle():
    def row(cell, scene, error, right=False):
        return Row(
            cell=cell,
            scene_id=scene,
            settings={},
            scene="",
            object=0,
            object_name="",
            symmetry="none",
            status="estimated",
            rotation_error_deg_sym=error,
            success_sym=right,
        )

    rows = [row("a", 0, 7.0), row("a", 1, None), row("a", 2, 1.0, right=True), row("a", 3, 90.0), row("b", 0, 7.0)]
    assert best_cell(rows) == "a"
    assert [r.scene_id for r in worst_rows(rows[:4], 2)] == [1, 3]


def test_a_cell_is_read_back_as_it_was_written(run):
    cells = expand(load_experiment("quick"))
    assert [Cell.read(cell.resolved()).resolved() for cell in cells] == [cell.resolved() for cell in cells]


def test_a_capture_is_recorded(dataset, read, tmp_path):
    (cell,) = expand(load_experiment("quick", {"pipeline.matcher": ["sift"], "pipeline.views": [2]}))[:1]
    path = view_capture(dataset / "000000", cell, tmp_path / "c.rrd")
    assert "capture 000000" in read(path)["/summary"]["text"][0]


def test_no_viewer_opens_without_a_display(monkeypatch, tmp_path):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not open_viewer(tmp_path / "x.rrd")


def test_the_viewer_opens_the_recording_where_there_is_a_display(monkeypatch, tmp_path):
    started = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("toolkit.harness.view.subprocess.Popen", lambda command, **_: started.append(command))
    assert open_viewer(tmp_path / "x.rrd")
    assert started == [[sys.executable, "-m", "rerun", str(tmp_path / "x.rrd")]]


# Films


def test_a_film_s_recording_follows_the_objects(cache, read, tmp_path):
    chunk = pytest.importorskip("rerun.chunk")
    config = TabletopConfig(scenes=1, min_objects=2, max_objects=2, views=1, seed=3, renderer="tiny", supersample=1)
    scene = draw_scene(config, load_object_set("procedural", cache), 0, cache)
    executor = Kinematic()
    path = tmp_path / "film.rrd"
    try:
        with record_poses(executor, scene, path) as on_frame, Film(executor, tmp_path / "f.mp4", 5, on_frame):
            executor.begin(scene)
            points = transform_points(scene.current[0], scene.assets[0].model.center + np.zeros((1, 3)))
            T = scene.goal[0] @ np.linalg.inv(scene.current[0])
            outcome = executor.pick_place(PickPlace(points, T, np.zeros((0, 3))))
        assert outcome.failure is None
        end = executor.state()[0]
    finally:
        executor.close()
    found = read(path)
    assert path.stat().st_size < 2_000_000
    assert bytes(found["/table/0"]["blob"][0])[:4] == b"glTF"
    np.testing.assert_allclose(np.ravel(found["/table/0"]["translation"]), end[:3, 3], atol=1e-6)
    parts = [c for c in chunk.RrdReader(path).stream().to_chunks() if c.entity_path == "/table/0" and not c.is_static]
    assert sum(part.num_rows for part in parts) > 5
    still = [c for c in chunk.RrdReader(path).stream().to_chunks() if c.entity_path == "/table/1" and not c.is_static]
    assert sum(part.num_rows for part in still) == 1
    center = transform_points(scene.goal[1], scene.assets[1].model.center)
    np.testing.assert_allclose(np.ravel(found["/goal/1"]["translation"]), center, atol=1e-6)
