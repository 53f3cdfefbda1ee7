"""One contract over every registered implementation of descriptors, indexes, retrievers and matchers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from kornia.feature import LoFTR

from toolkit.crops import crop_region
from toolkit.errors import ToolkitError
from toolkit.matchers.turns import TurningConfig, TurningMatcher, turn
from toolkit.models.efficientnet_lite import EfficientNetLite0
from toolkit.models.mixvpr import mixer_lite
from toolkit.retrieval.distance import geodesic_distance, paper_distance
from toolkit.stages import DESCRIPTORS, INDEXES, MATCHERS, RETRIEVERS
from toolkit.types import Crop, Matches, Segment


@pytest.fixture(scope="session")
def loftr_file(tmp_path_factory):
    """A LoFTR checkpoint of the official shape with random weights, as its authors' files hold them."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "loftr_outdoor.ckpt"
    torch.save({"state_dict": LoFTR(pretrained=None).state_dict()}, path)
    return path


@pytest.fixture(params=MATCHERS.names())
def matcher(request, loftr_file):
    # Random weights are confident of nothing: let every mutual match through.
    settings = (
        {"weights": "outdoor", "file": str(loftr_file), "crop_size": 128, "threshold": 0.0}
        if request.param == "loftr"
        else {}
    )
    made = MATCHERS.create(request.param, settings)
    try:
        made.check_ready()
    except ToolkitError as error:
        if "cannot be fetched" not in str(error):
            raise
        pytest.skip(str(error))
    return made


@pytest.fixture(scope="session")
def network_files(tmp_path_factory):
    """Random weights for the descriptors' networks, by setting."""
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("networks")
    backbone, mixer = folder / "backbone.pth", folder / "mixer.pth"
    torch.save(EfficientNetLite0().state_dict(), backbone)
    torch.save(mixer_lite().state_dict(), mixer)
    return {"gem": {"backbone_file": str(backbone)}, "mixvpr": {"backbone_file": str(backbone), "file": str(mixer)}}


@pytest.fixture(params=DESCRIPTORS.names())
def descriptor(request, network_files):
    return DESCRIPTORS.create(request.param, network_files.get(request.param))


@pytest.fixture(params=INDEXES.names())
def index(request):
    return INDEXES.create(request.param)


@pytest.fixture(params=RETRIEVERS.names())
def retriever(request):
    return RETRIEVERS.create(request.param)


def crops_of(capture, size):
    """Crops of the first two current frames' objects."""
    return [
        crop_region(frame.rgb, Segment(mask), size)
        for frame in capture.current[:2]
        for mask in frame.true_masks.values()
    ]


def blank(size):
    """A crop without any texture, and one pixel of mask."""
    mask = np.zeros((size, size), bool)
    mask[size // 2, size // 2] = True
    return Crop(np.zeros((size, size, 3), np.uint8), mask, 1.0, np.zeros(2))


def test_descriptors_are_unit_rows_that_depend_on_their_crop_alone(descriptor, capture):
    crops = crops_of(capture, descriptor.crop_size)
    together = descriptor.describe(crops)
    assert together.dtype == np.float32 and len(together) == len(crops)
    np.testing.assert_allclose(np.linalg.norm(together, axis=1), 1, atol=1e-5)
    alone = np.concatenate([descriptor.describe([crop]) for crop in crops])
    np.testing.assert_allclose(alone, together, atol=1e-6)


def test_descriptors_tell_objects_apart(descriptor, capture):
    """A crop is nearer to itself, slightly darker, than to another object."""
    crops = crops_of(capture, descriptor.crop_size)
    darker = [Crop((crop.image * 0.95).astype(np.uint8), crop.mask, crop.scale, crop.origin_xy) for crop in crops]
    similarity = descriptor.describe(darker) @ descriptor.describe(crops).T
    assert (similarity.argmax(axis=1) == np.arange(len(crops))).all()


def test_descriptors_stand_a_blank_crop(descriptor):
    vector = descriptor.describe([blank(descriptor.crop_size)])
    assert np.isfinite(vector).all()


def test_indexes_agree_with_brute_force(index):
    rng = np.random.default_rng(0)
    vectors, queries = (rng.standard_normal((n, 24)).astype(np.float32) for n in (40, 7))
    index.build(vectors)
    scores, rows = index.search(queries, 10)
    expected = np.sort(queries @ vectors.T, axis=1)[:, ::-1][:, :10]
    np.testing.assert_allclose(scores, expected, rtol=1e-5)
    np.testing.assert_allclose(np.take_along_axis(queries @ vectors.T, rows, 1), scores, rtol=1e-5)


def test_an_index_gives_no_more_than_it_has_and_forgets_what_was_there(index):
    vectors = np.eye(5, dtype=np.float32)
    index.build(vectors)
    index.build(vectors[:3])
    scores, rows = index.search(vectors[:1], 10)
    assert scores.shape == rows.shape == (1, 3)
    assert sorted(rows[0].tolist()) == [0, 1, 2]


def test_a_traversal_gives_every_candidate_at_most_once(retriever):
    rng = np.random.default_rng(0)
    observations = rng.standard_normal((24, 3))
    observations /= np.linalg.norm(observations, axis=1, keepdims=True)
    instances = np.repeat(np.arange(4), 6)
    traversal = retriever.start(rng.permutation(24), instances, observations)
    seen = []
    while rows := traversal.next(2):
        assert len(rows) <= 2
        seen += rows
        traversal.reject(rows[0])
    assert len(seen) == len(set(seen)) > 0
    assert set(seen) <= set(range(24))


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
    """DESIGN 12: arctan(y / x) does not tell a view from the one across the table."""
    front, back = np.array([0.6, 0.3, 0.74]), np.array([-0.6, -0.3, 0.74])
    front, back = front / np.linalg.norm(front), back / np.linalg.norm(back)
    assert paper_distance(front[None], back)[0] == pytest.approx(0, abs=1e-6)
    assert geodesic_distance(front[None], back)[0] > np.radians(80)


def test_matches_lie_on_both_objects_and_repeat(matcher, capture):
    crops = crops_of(capture, matcher.crop_size)
    features = matcher.extract(crops)
    found = matcher.match(features[0], features)
    assert len(found) == len(crops)
    for matches, crop in zip(found, crops, strict=True):
        for xy, mask in ((matches.query_xy, crops[0].mask), (matches.reference_xy, crop.mask)):
            x, y = np.rint(xy).astype(int).T
            assert mask[y, x].all()
        assert ((matches.scores >= 0) & (matches.scores <= 1)).all()
    again = matcher.match(features[0], features)
    assert all(a.query_xy.tobytes() == b.query_xy.tobytes() for a, b in zip(found, again, strict=True))


def test_a_batch_gives_what_single_pairs_give(matcher, capture):
    features = matcher.extract(crops_of(capture, matcher.crop_size))
    together = matcher.match(features[0], features)
    alone = [matcher.match(features[0], [feature])[0] for feature in features]
    for a, b in zip(together, alone, strict=True):
        assert len(a) == len(b)
        np.testing.assert_allclose(a.query_xy, b.query_xy, atol=0.05)


def test_a_crop_matches_itself_in_place(matcher, capture):
    features = matcher.extract(crops_of(capture, matcher.crop_size)[:1])
    (matches,) = matcher.match(features[0], features)
    assert len(matches) >= 3
    # A coarse cell of LoFTR's: random weights cannot refine within it.
    assert np.median(np.linalg.norm(matches.query_xy - matches.reference_xy, axis=1)) < 8.0


def test_a_blank_crop_matches_nothing_and_breaks_nothing(matcher, capture):
    crops = crops_of(capture, matcher.crop_size)
    features = matcher.extract([blank(matcher.crop_size), crops[0]])
    for matches in matcher.match(features[0], features):
        assert len(matches) <= 1


@pytest.mark.parametrize("quarters", range(4))
def test_turned_crops_match_where_they_were(quarters, capture):
    """A matcher that stands no rotation finds a turned crop again by trying four turns."""

    class Pixels(TurningMatcher):
        """Matches every tenth pixel of an object to the same pixel, where both images are equal."""

        Config = TurningConfig

        def extract_upright(self, crops):
            return crops

        def match_upright(self, query, references):
            y, x = (a[::10] for a in np.nonzero(query.mask))
            xy = np.stack([x, y], axis=1).astype(np.float64)
            same = [np.array_equal(query.image, reference.image) for reference in references]
            return [Matches(xy, xy, np.ones(len(xy))) if equal else Matches.empty() for equal in same]

    crop = crops_of(capture, 64)[0]
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
