"""Grasps that hold are lifted, others are not, the same way every time."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest
import trimesh

from toolkit.data.objects import load_object_set
from toolkit.geometry import make_transform
from toolkit.rearrangement.grasps.antipodal import Antipodal
from toolkit.rearrangement.moves import Grasp, GraspRequest
from toolkit.sim.robots import ROBOTS

LIFT = Path(__file__).parents[2] / "experiments" / "benchmarks" / "lift.py"
lifted_height = runpy.run_path(str(LIFT))["lifted_height"]
GRIPPER = ROBOTS["gen3"].gripper
DOWN = np.diag([1.0, -1.0, -1.0])


@pytest.fixture
def box(tmp_path):
    """A box of 4 x 10 x 8 cm that stands on the table."""
    path = tmp_path / "box.stl"
    trimesh.creation.box((0.04, 0.10, 0.08)).export(path)
    return path


def lift(path, grasp_at, mass=0.2, R=DOWN):
    standing = make_transform(np.eye(3), np.array([0.1, 0.2, 0.04]))
    grasp = Grasp(make_transform(R, np.array(grasp_at)), opening=0.06, spare=0.01, score=1.0)
    return lifted_height([path], mass, standing, grasp, GRIPPER)


def test_a_firm_grasp_lifts(box):
    assert lift(box, (0.1, 0.2, 0.05)) == pytest.approx(0.15, abs=0.01)


def test_air_and_too_much_weight_are_not_lifted(box):
    assert lift(box, (0.3, 0.2, 0.05)) < 0.01
    assert lift(box, (0.1, 0.2, 0.05), mass=30) < 0.01


def test_a_lift_repeats_to_the_bit(box):
    assert lift(box, (0.1, 0.21, 0.05)) == lift(box, (0.1, 0.21, 0.05))


def test_grasps_found_on_the_surface_hold(cache):
    """One object of every family that has one; wide cartons and bowls among them may have no grasp at all."""
    grasper = Antipodal()
    held = []
    for asset in load_object_set("procedural", cache).assets[::17]:
        points, _ = trimesh.sample.sample_surface(trimesh.load(asset.mesh, force="mesh"), 6000, seed=0)
        standing = make_transform(np.eye(3), np.array([0, 0, -asset.model.box_min[2]]))
        points = np.asarray(points) + standing[:3, 3]
        seen = points[points[:, 2] > 0.003]
        found = grasper.grasp(GraspRequest(seen, np.eye(4), np.zeros((0, 3)), GRIPPER, 0.08), seed=0)
        if isinstance(found, list):
            held.append(lifted_height(asset.hulls, asset.mass_kg, standing, found[0], GRIPPER) > 0.02)
    assert len(held) >= 4 and np.mean(held) >= 0.8
