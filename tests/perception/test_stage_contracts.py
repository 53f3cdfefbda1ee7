"""The conformance kit over every registered implementation, and what is particular to some of them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from kornia.feature import LoFTR

from toolkit.errors import ToolkitError
from toolkit.models.efficientnet_lite import EfficientNetLite0
from toolkit.perception.matchers.shared.quarter_turns import TurningConfig, TurningMatcher, turn
from toolkit.perception.retrieval.candidates.distance import geodesic_distance, paper_distance
from toolkit.plugin_kit.conformance import Subject, checks_of, make_ready, run_check, title
from toolkit.plugin_kit.conformance.scene import crops
from toolkit.stages import REGISTRIES, RETRIEVERS
from toolkit.types import Matches

CASES = [
    pytest.param(stage, name, check, id=f"{stage}-{name}-{title(check)}")
    for stage, registry in REGISTRIES.items()
    for name in registry.names()
    for check in checks_of(stage)
]


SMALL = {"crop_size": 160, "max_features": 256}
"""What networks find at this size is as right or wrong as at theirs."""


@pytest.fixture(scope="session")
def chosen(tmp_path_factory):
    """Settings, by stage and name: small crops, and random weights, in files as their authors name them."""
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("weights")
    loftr, backbone = folder / "loftr_outdoor.ckpt", folder / "efficientnet-lite0-57934424.pth"
    torch.save({"state_dict": LoFTR(pretrained=None).state_dict()}, loftr)
    torch.save(EfficientNetLite0().state_dict(), backbone)
    return {
        **{("matcher", name): SMALL for name in ("aliked_lightglue", "disk_lightglue", "xfeat_lighterglue")},
        ("matcher", "xfeat_star"): {"crop_size": 160},
        # Random weights are confident of nothing: let every mutual match through.
        ("matcher", "loftr"): {"weights": "outdoor", "file": str(loftr), "crop_size": 128, "threshold": 0.0},
        ("descriptor", "gem"): {"backbone_file": str(backbone)},
        ("descriptor", "mixvpr"): {"backbone_file": str(backbone)},
    }


@pytest.fixture(scope="session")
def find_subject(chosen):
    """Subject by stage and name, or the sentence that says what it lacks."""

    @lru_cache
    def find(stage, name):
        subject = Subject(REGISTRIES[stage].get(name), chosen.get((stage, name), {}))
        try:
            make_ready(subject)
        except ToolkitError as error:
            return str(error)
        return subject

    return find


@pytest.mark.parametrize(("stage", "name", "check"), CASES)
def test_every_implementation_conforms(stage, name, check, find_subject):
    subject = find_subject(stage, name)
    if isinstance(subject, str):
        pytest.skip(subject)
    outcome = run_check(check, subject)
    assert outcome.passed, outcome.note


def test_the_best_ranked_region_is_tried_first():
    ranking, instances = np.array([3, 2, 1, 0]), np.array([0, 0, 1, 1])
    assert RETRIEVERS.create("instance_vote").start(ranking, instances, np.tile([0.0, 0.0, 1.0], (4, 1))).next(1) == [3]


def test_a_rejected_view_takes_its_neighbours_along():
    """Sec. Method A: candidates whose observation is close to a rejected one's are deleted."""
    angles = np.radians([0, 10, 90])
    observations = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    traversal = RETRIEVERS.create("instance_vote", {"prune_deg": 20}).start(
        np.array([0, 1, 2]), np.zeros(3, np.int64), observations
    )
    assert traversal.next(1) == [0]
    traversal.reject(0)
    assert traversal.next(2) == [2]


unit = arrays(np.float64, 3, elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 0.1)


@settings(deadline=None)
@given(unit, unit)
def test_distances_are_symmetric_angles(a, b):
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    for distance in (geodesic_distance, paper_distance):
        assert distance(a[None], b)[0] == pytest.approx(distance(b[None], a)[0], abs=1e-9)
        assert distance(a[None], a)[0] == pytest.approx(0, abs=1e-6)
        assert 0 <= distance(a[None], b)[0] <= 2 * np.pi


def test_the_printed_distance_confuses_opposite_azimuths():
    """arctan(y / x) of Eq. obs_pose_distance does not tell a view from the one across the table."""
    front, back = np.array([0.6, 0.3, 0.74]), np.array([-0.6, -0.3, 0.74])
    front, back = front / np.linalg.norm(front), back / np.linalg.norm(back)
    assert paper_distance(front[None], back)[0] == pytest.approx(0, abs=1e-6)
    assert geodesic_distance(front[None], back)[0] > np.radians(80)


@pytest.mark.parametrize("quarters", range(4))
def test_turned_crops_match_where_they_were(quarters):
    """A matcher that stands no rotation finds a turned crop again by trying four turns."""

    class Pixels(TurningMatcher):
        """Matches every tenth pixel of an object to the same pixel, where both images are equal."""

        crop_size = 64

        def extract_upright(self, crops):
            return crops

        def match_upright(self, query, references):
            y, x = (a[::10] for a in np.nonzero(query.mask))
            xy = np.stack([x, y], axis=1).astype(np.float64)
            same = [np.array_equal(query.image, reference.image) for reference in references]
            return [Matches(xy, xy, np.ones(len(xy))) if equal else Matches.empty() for equal in same]

    crop = crops(64)[0]
    turned = turn(crop, quarters)
    four = Pixels(TurningConfig(rotations=4))
    query, reference = four.extract([crop, turned])
    (matches,) = four.match(query, [reference])
    assert len(matches) > 10
    x, y = matches.query_xy.astype(int).T
    u, v = matches.reference_xy.astype(int).T
    assert (crop.image[y, x] == turned.image[v, u]).all()
    one = Pixels(TurningConfig(rotations=1))
    assert (len(one.match(*(lambda a, b: (a, [b]))(*one.extract([crop, turned])))[0]) > 0) == (quarters == 0)
