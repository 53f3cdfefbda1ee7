"""Results in other tools' files: BOP's CSV scored by its published formulas, PLY models, PoseStamped as JSON."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from exported import rows_of, transform_of
from written import small_capture

from toolkit.data.bop import load_capture
from toolkit.data.clouds import read_cloud
from toolkit.data.exporting import EXPORTERS
from toolkit.data.exporting.results import read_results
from toolkit.errors import ToolkitError
from toolkit.geometry import make_transform, rotation_z
from toolkit.perception.database import Database
from toolkit.perception.fusion import Models, clouds
from toolkit.perception.tabletop.plane import pixel_rays
from toolkit.pictures.poses import write_poses
from toolkit.plugin_kit.conformance.raycast import NOW, THEN
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame, regions, segments_of, true_motion
from toolkit.results.poses import Poses, matrix, read_poses
from toolkit.types import Abstention, Failure, Finding, PoseEstimate

SHIFT = make_transform(np.eye(3), np.array([0.012, -0.005, 0]))
CENTER = make_transform(np.eye(3), np.array(THEN[2][0]))
HALF_TURN = CENTER @ rotation_z(np.pi) @ np.linalg.inv(CENTER)
"""About the third box's own axis, after which it looks the same."""

MOTIONS = (true_motion(1), SHIFT @ true_motion(2), HALF_TURN @ true_motion(3))


def estimates(motions=MOTIONS):
    equivalents = np.stack([motions[2], true_motion(3)])
    said = [
        {"confidence": 0.9},
        {"confidence": 0.25, "covariance": np.eye(6) * 1e-4},
        {"equivalents": equivalents, "ambiguity": "symmetric"},
    ]
    times = {"matcher": 12.3456, "pnp": 1.5}
    return [
        PoseEstimate(number, segment, number, motion, time_ms=times, **more)
        for number, (segment, motion, more) in enumerate(zip(segments_of(goal_frame()), motions, said, strict=True))
    ]


def result(folder: Path, made=None) -> Path:
    """What `estimate` writes for the small capture, whose instance n is box n + 1."""
    found, instances = regions()
    database = Database(current_frames(), found, instances, np.zeros((len(found), 1), np.float32))
    capture = load_capture(small_capture(folder / "000042"))
    findings = [Finding("doubtful", "it is dark", 0.3)]
    models = clouds(database, Models(database))
    write_poses(folder / "result", capture, database, models, estimates() if made is None else made, findings)
    return folder / "result"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    result(folder)
    return folder


def export(kind, made: Path, out: Path, **settings) -> list[str]:
    return EXPORTERS.create(kind, settings).write(read_results(made), out)


# poses.json.


def test_poses_json_tells_where_instances_are_and_what_was_seen_in_one_scene_only(tmp_path):
    first, second, _ = estimates()
    unknown = PoseEstimate(2, first.segment, None, None, Failure("explainer", "it is new"))
    withheld = PoseEstimate(1, second.segment, 1, None, Abstention("refiner", "not believed"), confidence=0.01)
    poses = read_poses(result(tmp_path, [first, withheld, unknown]) / "poses.json")
    assert poses.schema_ == 2 and poses.capture == "000042"
    assert [entry.status for entry in poses.objects] == ["estimated", "abstained", "failed"]
    assert poses.not_in_goal == [2] and poses.not_in_current == [2]
    assert [f.sentence for f in poses.findings] == ["it is dark"] and poses.findings[0].cap == 0.3
    for instance, (base, size) in zip(poses.instances, NOW, strict=True):
        middle = np.add(base, [0, 0, size[2] / 2])
        assert np.abs(np.subtract(instance.center, middle)).max() < 0.006
        assert np.abs(np.sort(instance.size[:2]) - np.sort(size[:2])).max() < 0.008
        outline = np.array(instance.footprint)
        assert (np.abs(outline[:, :2] - base[:2]) < np.array(size[:2]) / 2 + 0.004).all()
        assert _area(outline[:, :2]) > 0.8 * size[0] * size[1]  # positive: counter-clockwise
        points, colors = read_cloud(tmp_path / "result" / instance.model)
        assert (np.abs(points[:, :2] - base[:2]) < np.array(size[:2]) / 2 + 0.004).all()
        assert colors.shape == points.shape and colors.max() > 100
    assert poses.instance(1) == poses.instances[1] and poses.instance(7) is None


def _area(outline) -> float:
    x, y = outline.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def test_equivalents_and_covariance_are_as_they_were(made):
    poses = read_poses(made / "result/poses.json")
    for entry, estimate in zip(poses.objects, estimates(), strict=True):
        np.testing.assert_array_equal(matrix(entry.T_goal_current), estimate.T_goal_current)
        assert (entry.confidence, entry.ambiguity) == (estimate.confidence, estimate.ambiguity)
    np.testing.assert_array_equal(poses.objects[2].equivalents, estimates()[2].equivalents)
    np.testing.assert_array_equal(poses.objects[1].covariance, estimates()[1].covariance)


def test_files_of_the_first_schema_are_read(tmp_path, made):
    """As DESIGN had it at first, without what came later."""
    data = json.loads((made / "result/poses.json").read_text())
    later = ("ambiguity", "covariance", "equivalents")
    objects = [{key: value for key, value in entry.items() if key not in later} for entry in data["objects"]]
    objects[0]["instance"] = None
    (tmp_path / "poses.json").write_text(json.dumps({"schema": 1, "capture": "old", "objects": objects}))
    poses = read_poses(tmp_path / "poses.json")
    assert poses.not_in_current == [0] and poses.instances == [] and poses.findings == []
    assert poses.objects[1].T_goal_current == data["objects"][1]["T_goal_current"]
    with pytest.raises(ToolkitError, match="is of schema 1; estimate again"):
        read_results(tmp_path)
    for text, said in (
        ('{"schema": 3}', "is of schema 3; 1 and 2 are read"),
        ("[]", "is of schema None"),
        ('{"schema": 1}', "see 'objects'"),
        ('{"schema": 2, "capture": 3}', "see capture"),
    ):
        (tmp_path / "poses.json").write_text(text)
        with pytest.raises(ToolkitError, match=said):
            read_poses(tmp_path / "poses.json")
    with pytest.raises(ToolkitError, match=r"holds no poses\.json"):
        read_results(tmp_path / "nowhere")


def test_the_schema_in_the_docs_is_that_of_the_files():
    written = Path(__file__).parents[2] / "docs" / "poses.schema.json"
    assert json.loads(written.read_text()) == Poses.model_json_schema()


# BOP: read as its documentation says, scored as its papers say (Hodan et al., ECCVW 2020, Sec. 2.2).


class BopTruth:
    """One object in the goal image, from the capture's JSON files alone; millimetres."""

    def __init__(self, capture: Path, obj_id: int) -> None:
        entry = next(e for e in json.loads((capture / "goal/scene_gt.json").read_text())["0"] if e["obj_id"] == obj_id)
        self.R, self.t = np.array(entry["cam_R_m2c"]).reshape(3, 3), np.array(entry["cam_t_m2c"])
        self.K = np.array(json.loads((capture / "goal/scene_camera.json").read_text())["0"]["cam_K"]).reshape(3, 3)
        info = json.loads((capture / "models_info.json").read_text())[str(obj_id)]
        self.low = np.array([info[f"min_{axis}"] for axis in "xyz"])
        self.high = self.low + [info[f"size_{axis}"] for axis in "xyz"]
        self.diameter = info["diameter"]
        corners = np.stack(np.meshgrid(*zip(self.low, self.high, strict=True)), axis=-1)
        self.points = corners.reshape(-1, 3)
        self.symmetries = [np.eye(4), *np.array(info["symmetries_discrete"]).reshape(-1, 4, 4)]

    def places(self, R, t, S=None):
        S = np.eye(4) if S is None else S
        return (self.points @ S[:3, :3].T + S[:3, 3]) @ R.T + t

    def pixels(self, in_camera):
        return (in_camera @ self.K.T)[:, :2] / in_camera[:, 2:]

    def mssd(self, R, t) -> float:
        """Largest distance of a vertex, at the symmetry that makes it least."""
        own = self.places(R, t)
        return min(np.linalg.norm(own - self.places(self.R, self.t, S), axis=1).max() for S in self.symmetries)

    def mspd(self, R, t) -> float:
        """The same in pixels."""
        own = self.pixels(self.places(R, t))
        true = [self.pixels(self.places(self.R, self.t, S)) for S in self.symmetries]
        return min(np.linalg.norm(own - pixels, axis=1).max() for pixels in true)

    def distances(self, R, t):
        """(H, W) from the camera's centre to the box's surface, 0 where it is not: the mesh, rendered."""
        rays = pixel_rays(goal_frame()).astype(np.float64)
        rays /= np.linalg.norm(rays, axis=2, keepdims=True)
        eye, ahead = -R.T @ t, rays @ R
        with np.errstate(divide="ignore"):
            a, b = (self.low - eye) / ahead, (self.high - eye) / ahead
        enter, leave = np.minimum(a, b).max(axis=2), np.maximum(a, b).min(axis=2)
        return np.where((enter < leave) & (enter > 0), enter, 0)

    def vsd(self, R, t, tau: float, delta: float = 15) -> float:
        """Part of the visible surface that is elsewhere, or off by `tau` diameters; nothing hides a box here."""
        own, true = self.distances(R, t), self.distances(self.R, self.t)
        scene = np.where(true > 0, true, 5000)
        seen_true = true > 0
        seen_own = (own > 0) & ((own - scene <= delta) | seen_true)
        both, either = seen_own & seen_true, seen_own | seen_true
        off = np.abs(own - true)[both] / self.diameter >= tau
        return float((off.sum() + (either & ~both).sum()) / either.sum())


def test_bop_results_score_as_the_motions_do(made, tmp_path):
    capture = made / "000042"
    assert export("bop", made / "result", tmp_path / "out.csv", captures=str(capture)) == []
    rows = rows_of(tmp_path / "out.csv")
    assert [(row["scene_id"], row["im_id"], row["obj_id"], row["score"]) for row in rows] == [
        *((42, 0, 1, 0.9), (42, 0, 2, 0.25), (42, 0, 3, 1.0))
    ]
    assert [row["time"] for row in rows] == pytest.approx([3 * 13.846 / 1e3] * 3)
    for row, truth in ((row, BopTruth(capture, row["obj_id"])) for row in rows):
        shifted = row["obj_id"] == 2
        mm = 1000 * np.linalg.norm(SHIFT[:3, 3]) if shifted else 0
        assert truth.mssd(row["R"], row["t"]) == pytest.approx(mm, abs=1e-6)
        px = truth.mspd(row["R"], row["t"])
        assert (4 < px < 8) if shifted else px < 1e-6  # 13 mm at 0.9 m, 308 px of focal length
        vsd = [truth.vsd(row["R"], row["t"], tau) for tau in (0.05, 0.5)]
        assert (vsd[0] >= vsd[1] > 0.3) if shifted else vsd == [0, 0]
    # Without its symmetry, the half turn would be as wrong as can be.
    third = BopTruth(capture, 3)
    third.symmetries = third.symmetries[:1]
    assert third.mssd(rows[2]["R"], rows[2]["t"]) == pytest.approx(70 * 2**0.5)


def test_bop_results_name_the_object_that_the_instance_is(tmp_path):
    """Whatever the goal image shows: a goal object that is taken for another box gets that box's obj_id."""
    first, second, third = estimates()
    swapped = PoseEstimate(0, first.segment, 2, MOTIONS[0], confidence=0.7)
    failed = PoseEstimate(1, second.segment, 1, None, Failure("pnp", "too few matches"))
    folder = result(tmp_path, [swapped, failed, third])
    captures = str(tmp_path / "000042")
    assert export("bop", folder, tmp_path / "out.csv", captures=captures, scene=7) == []
    assert [(row["scene_id"], row["obj_id"]) for row in rows_of(tmp_path / "out.csv")] == [(7, 3), (7, 3)]
    # An instance that is no object of the truth is not made one.
    own = small_capture(tmp_path / "other" / "000042")
    for scene in ("current", "goal"):
        for path in [own / scene / "scene_gt.json"]:
            data = json.loads(path.read_text())
            for entries in data.values():
                for entry in entries:
                    entry["T_world_model"][2][3] += 0.5
            path.write_text(json.dumps(data))
    notes = export("bop", folder, tmp_path / "other.csv", captures=str(own))
    assert notes == ["000042: instance 2 is no object of the truth: left out"] * 2
    with pytest.raises(ToolkitError, match="has no truth"):
        bare = small_capture(tmp_path / "bare", truth=False)
        export("bop", folder, tmp_path / "no.csv", captures=str(bare))


def test_several_results_are_one_csv_of_several_scenes(made, tmp_path):
    for name in ("000001", "000002"):
        small_capture(tmp_path / "set" / name)
        shutil.copytree(made / "result", tmp_path / "run" / name)
    export("bop", tmp_path / "run", tmp_path / "out.csv", captures=str(tmp_path / "set"))
    assert [row["scene_id"] for row in rows_of(tmp_path / "out.csv")] == [1, 1, 1, 2, 2, 2]
    export("ros", tmp_path / "run", tmp_path / "ros")
    assert sorted(path.name for path in (tmp_path / "ros").iterdir()) == ["000001.json", "000002.json"]
    with pytest.raises(ToolkitError, match="leave it out"):
        export("bop", tmp_path / "run", tmp_path / "out.csv", captures=str(tmp_path / "set"), scene=3)


# PLY and ROS.


@pytest.mark.parametrize(("place", "boxes"), [("current", NOW), ("goal", THEN)])
def test_ply_models_stand_where_the_boxes_do(made, tmp_path, place, boxes):
    export("ply", made / "result", tmp_path / "ply", place=place)
    files = sorted((tmp_path / "ply").iterdir())
    assert [path.name for path in files] == ["000000.ply", "000001.ply", "000002.ply"]
    for number, (path, (base, size)) in enumerate(zip(files, boxes, strict=True)):
        points, _ = read_cloud(path)
        shift = SHIFT[:2, 3] if place == "goal" and number == 1 else 0
        assert (np.abs(points[:, :2] - base[:2] - shift) < np.array(size[:2]) / 2 + 0.004).all()
        assert path.read_bytes().startswith(b"ply\nformat binary_little_endian 1.0\n")


def test_ros_poses_are_where_the_boxes_are_and_go(tmp_path):
    first, _, third = estimates()
    failed = PoseEstimate(1, first.segment, None, None, Failure("explainer", "it is new"))
    folder = result(tmp_path, [first, failed, third])
    export("ros", folder, tmp_path / "poses.ros.json", frame="base_link")
    told = json.loads((tmp_path / "poses.ros.json").read_text())
    assert told["capture"] == "000042"
    poses = read_poses(folder / "poses.json")
    for entry, instance in ((told["objects"][0], poses.instances[0]), (told["objects"][2], poses.instances[2])):
        now, then = transform_of(entry["current"]), transform_of(entry["goal"])
        np.testing.assert_allclose(now, matrix(instance.T_world_box), atol=1e-6)
        np.testing.assert_allclose(then, MOTIONS[entry["goal_object"]] @ now, atol=1e-9)
        assert list(entry["size"].values()) == instance.size
    unknown = told["objects"][1]
    assert unknown["current"] is unknown["goal"] is None and unknown["reason"] == "it is new"
