"""The parts of Contact-GraspNet against plain definitions, and its grasps where the weights can be had."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from toolkit.errors import ToolkitError
from toolkit.models.contact_graspnet import ContactGraspNet, used
from toolkit.models.pointnet2 import balls, farthest_points, interpolate
from toolkit.rearrangement.grasps.contact_graspnet import ContactGraspnet, on_table
from toolkit.rearrangement.grasps.geometry.surface import span
from toolkit.rearrangement.moves import GraspRequest
from toolkit.sim.robots import ROBOTS
from toolkit.weights.load import fill

POINTS = torch.rand(500, 3, generator=torch.Generator().manual_seed(0))


def test_every_farthest_point_is_the_farthest_from_those_before_it():
    chosen = farthest_points(POINTS, 40, start=7)
    assert chosen[0] == 7 and len(set(chosen.tolist())) == 40
    for count in range(1, 40):
        nearest = torch.cdist(POINTS, POINTS[chosen[:count]]).min(dim=1).values
        assert nearest[chosen[count]] == pytest.approx(float(nearest.max()), abs=1e-6)
    assert len(farthest_points(POINTS[:5], 40)) == 5


def test_balls_hold_the_first_points_within_reach_and_are_filled_with_the_first():
    centers = POINTS[:300]
    tree = KDTree(POINTS.numpy())
    for radius, found in zip((0.1, 0.3), balls(POINTS, centers, (0.1, 0.3), 8), strict=True):
        for center, row in zip(centers.numpy(), found.tolist(), strict=True):
            expected = sorted(tree.query_ball_point(center, radius))[:8]
            assert row == expected + [expected[0]] * (8 - len(expected))


def test_interpolation_keeps_what_is_known_and_weights_by_inverse_squared_distance():
    features = torch.rand(500, 4, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(interpolate(features, POINTS, POINTS[:50]), features[:50])
    line = torch.tensor([[0.0, 0, 0], [3.0, 0, 0], [100.0, 0, 0]])
    value = interpolate(torch.tensor([[0.0], [1.0], [0.0]]), line, torch.tensor([[1.0, 0, 0]]))
    assert float(value) == pytest.approx((1 / 4) / (1 + 1 / 4 + 1 / 99**2), abs=1e-5)


@pytest.fixture(scope="module")
def untrained():
    torch.manual_seed(0)
    return ContactGraspNet().eval()


@torch.inference_mode()
def test_grasps_are_frames_at_points_of_the_cloud_and_repeat_with_the_seed(untrained):
    first, second, other = (untrained(POINTS / 4, torch.Generator().manual_seed(seed)) for seed in (3, 3, 4))
    assert sorted(first.contacts.tolist()) == list(range(500))
    for vectors in (first.baselines, first.approaches):
        torch.testing.assert_close(vectors.norm(dim=1), torch.ones(500))
    assert (first.baselines * first.approaches).sum(dim=1).abs().max() < 1e-5
    assert (first.widths >= 0).all() and ((first.scores > 0) & (first.scores < 1)).all()
    assert torch.equal(first.scores, second.scores) and not torch.equal(first.contacts, other.contacts)


@torch.inference_mode()
def test_where_the_cloud_lies_does_not_matter_to_its_encoder(untrained):
    """Only the heads see where a point is."""
    seen = []
    handles = [untrained.feat_prop[2].register_forward_hook(lambda *call: seen.append(call[2]))]
    for shift in (0.0, 0.5):
        untrained(POINTS / 4 + shift, torch.Generator().manual_seed(0))
    handles[0].remove()
    torch.testing.assert_close(seen[0], seen[1], atol=1e-3, rtol=1e-3)


def test_layers_without_effect_are_left_out_and_others_are_not(untrained, tmp_path):
    tensors = untrained.state_dict() | {"set_abstract_final.0.0.weight": torch.zeros(256, 640)}
    fill(ContactGraspNet(), used(tensors), tmp_path, "Contact-GraspNet")
    with pytest.raises(ToolkitError, match="holds 'more'"):
        fill(ContactGraspNet(), used(tensors | {"more": torch.zeros(1)}), tmp_path, "Contact-GraspNet")


def test_a_file_without_a_checkpoint_is_said_before_work(tmp_path):
    path = tmp_path / "cgn.pth"
    torch.save({"state_dict": {"a": torch.zeros(1)}}, path)
    with pytest.raises(ToolkitError, match="not a checkpoint of Contact-GraspNet"):
        ContactGraspnet(ContactGraspnet.Config.model_validate({"file": path})).check_ready()


def test_the_network_sees_the_object_first_then_near_neighbours_and_table_beside_them():
    rng = np.random.default_rng(0)
    thing = rng.uniform(-0.03, 0.03, (400, 3)) + np.array([0.2, 0, 0.03])
    near, far = thing + np.array([0, 0.1, 0]), thing + np.array([0, 0.5, 0])
    request = GraspRequest(thing, np.eye(4), np.concatenate([near, far]), ROBOTS["gen3"].gripper, 0.08)
    cloud = on_table(request, 0.25, 0.01, rng)
    np.testing.assert_array_equal(cloud[:800], np.concatenate([thing, near]))
    table = cloud[800:]
    assert (table[:, 2] == 0.01).all() and 3000 < len(table) < 5200
    assert KDTree(cloud[:800, :2]).query(table[:, :2])[0].min() > 0.01


def test_the_opposite_contact_is_the_last_point_on_the_line_that_the_gripper_spans():
    xs = np.array([-0.03, 0.0, 0.02, 0.05, 0.12])
    points = np.column_stack([xs, np.zeros((5, 2))])
    x = np.array([1.0, 0, 0])
    for line in (x, -x):
        np.testing.assert_allclose(span(points, points[1], line, 0.13)[1], points[4])
        np.testing.assert_allclose(span(points, points[3], line, 0.085)[1], points[0])
    for start, line in ((points[1], np.array([0, 0, 1.0])), (points[0], x)):  # nothing on it, or too far
        a, b = span(points, start, line, 0.085)
        np.testing.assert_allclose((a + b) / 2, start)
        assert np.linalg.norm(b - a) == pytest.approx(0.004)
