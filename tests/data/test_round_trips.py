"""Every kind of recording, all the way: imported, estimated, exported as every kind of file, and read back."""

from __future__ import annotations

import json

import numpy as np
import pytest
from exported import rows_of, transform_of
from recorded import FRAMES, WRITERS
from scipy.spatial.transform import Rotation
from written import true_objects

from toolkit.data.bop import load_capture, write_capture
from toolkit.data.clouds import read_cloud
from toolkit.data.exporting import EXPORTERS
from toolkit.data.exporting.results import read_results
from toolkit.data.importing import IMPORTERS
from toolkit.data.importing.choosing import Frames
from toolkit.data.importing.writing import Goal, import_capture
from toolkit.geometry import invert, make_transform, transform_points
from toolkit.harness.experiment import load_experiment, only_cell
from toolkit.harness.session import Session
from toolkit.pictures.poses import write_poses
from toolkit.results.poses import matrix

T_WORLD_SCENE = make_transform(Rotation.from_euler("xyz", [1.2, 0.4, -2.0]).as_matrix(), np.array([0.4, -1.0, 2.0]))
MOVED = tuple(frame.moved(T_WORLD_SCENE) for frame in FRAMES)
"""What is recorded, in a world that is not upright."""

TRUTH = true_objects(T_WORLD_SCENE)
QUICK = {"segmenter": "depth_plane", "explainer": "none", "refiner": "none"}
"""The cheapest pipeline that needs no masks and is right here."""


@pytest.fixture(scope="module")
def session():
    overrides = {f"pipeline.{slot}": [name] for slot, name in QUICK.items()}
    return Session(only_cell(load_experiment("estimate", overrides)))


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """The capture itself, with its truth."""
    folder = tmp_path_factory.mktemp("known") / "capture"
    write_capture(folder, MOVED[:-1], MOVED[-1], TRUTH)
    return folder


def motion_error(T, number: int) -> float:
    """How far a motion takes the corners of a box from where they go, metres."""
    true = TRUTH[number]
    corners = true.model.center + (np.indices((2, 2, 2)).reshape(3, -1).T - 0.5) * true.model.box_size
    now = transform_points(true.T_world_current, corners)
    return float(np.linalg.norm(transform_points(T, now) - transform_points(true.T_goal_current, now), axis=1).max())


# RealSense's playback leaves frames out on a busy machine.
@pytest.mark.parametrize(
    "kind", [pytest.param(name, marks=[pytest.mark.slow] if name == "realsense" else []) for name in WRITERS]
)
def test_there_and_back(kind, session, known, tmp_path):
    recorded = WRITERS[kind](tmp_path / kind, MOVED)
    importer = IMPORTERS.create(kind, recorded.settings)
    other = None if recorded.of_goal is None else importer.read(recorded.of_goal)
    import_capture(importer.read(recorded.source), tmp_path / "capture", Goal(str(recorded.goal), other), Frames())
    capture = load_capture(tmp_path / "capture")

    session.database(capture.current)
    estimates = session.estimate(capture.goal)
    scene = session.scene
    write_poses(tmp_path / "result", capture, scene.database, scene.clouds(), estimates, session.findings)
    (result,) = results = read_results(tmp_path / "result")
    motions = [matrix(entry.T_goal_current) for entry in result.poses.objects]
    boxes = [min(TRUTH, key=lambda number, T=T: motion_error(T, number)) for T in motions]
    assert sorted(boxes) == [1, 2, 3] and result.poses.findings == []
    assert max(motion_error(T, number) for T, number in zip(motions, boxes, strict=True)) < 0.005

    def export(name, out, **settings):
        assert EXPORTERS.create(name, settings).write(results, tmp_path / out) == []
        return tmp_path / out

    rows = rows_of(export("bop", "out.csv", captures=str(known)))
    assert [row["obj_id"] for row in rows] == boxes
    for row, T in zip(rows, motions, strict=True):
        in_camera = invert(MOVED[-1].camera.T_world_camera) @ T @ TRUTH[row["obj_id"]].T_world_current
        np.testing.assert_allclose(make_transform(row["R"], row["t"] / 1e3), in_camera, atol=1e-9)

    models = export("ply", "ply")
    for instance in result.poses.instances:
        for read, kept in zip(read_cloud(models / f"{instance.instance:06d}.ply"), result.cloud(instance), strict=True):
            np.testing.assert_array_equal(read, kept)

    told = json.loads(export("ros", "poses.json", frame="map").read_text())
    for entry, T in zip(told["objects"], motions, strict=True):
        box = matrix(result.poses.instance(entry["instance"]).T_world_box)
        np.testing.assert_allclose(transform_of(entry["current"], "map"), box, atol=1e-9)
        np.testing.assert_allclose(transform_of(entry["goal"], "map"), T @ box, atol=1e-9)


def test_every_kind_makes_the_trip():
    assert sorted(WRITERS) == IMPORTERS.names() and EXPORTERS.names() == ["bop", "ply", "ros"]
