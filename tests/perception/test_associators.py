"""Every associator on scenes whose instances are known; and what k-means must survive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.geometry import look_at, project
from toolkit.perception.regions import lift_segment
from toolkit.stages import ASSOCIATORS
from toolkit.types import Camera, Frame, Region, Segment

WIDTH, HEIGHT = 160, 120
K = np.array([[150.0, 0, 79.5], [0, 150.0, 59.5], [0, 0, 1]])

Ball = tuple[float, float, float]
"""Centre (x, y) on the table and radius, metres."""


def capture(
    balls: list[Ball], views: int = 6, hidden: frozenset[tuple[int, int]] = frozenset()
) -> tuple[list[Frame], list[Region], NDArray[np.int64]]:
    """Frames, regions and truth of balls ray-cast from a ring of views, (view, ball) pairs in `hidden` left out."""
    frames: list[Frame] = []
    regions: list[Region] = []
    owners: list[int] = []
    for v in range(views):
        a = 2 * np.pi * v / views
        view = Camera(K, look_at(np.array([0.8 * np.cos(a), 0.8 * np.sin(a), 0.7]), np.zeros(3)), WIDTH, HEIGHT)
        T = view.T_world_camera
        y, x = np.mgrid[:HEIGHT, :WIDTH]
        rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], axis=2) @ T[:3, :3].T
        depth, owner = np.full((HEIGHT, WIDTH), np.inf), np.full((HEIGHT, WIDTH), -1)
        for o, (cx, cy, radius) in enumerate(balls):
            if (v, o) in hidden:
                continue
            offset = T[:3, 3] - np.array([cx, cy, radius])
            A, B, C = (rays**2).sum(axis=2), rays @ offset, float(offset @ offset - radius**2)
            root = B * B - A * C
            t = (-B - np.sqrt(np.maximum(root, 0))) / A
            hit = (root > 0) & (t < depth)
            depth[hit], owner[hit] = t[hit], o
        masks = {o: owner == o for o in range(len(balls)) if (owner == o).sum() >= 20}
        z = np.where(np.isfinite(depth), depth, 0).astype(np.float32)
        frame = Frame(10 + v, np.zeros((HEIGHT, WIDTH, 3), np.uint8), view, z, masks)
        frames.append(frame)
        for o, mask in masks.items():
            region = lift_segment(frame, Segment(mask))
            assert isinstance(region, Region)
            regions.append(region)
            owners.append(o)
    return frames, regions, np.array(owners)


def followed(regions: list[Region], owners: NDArray[np.int64]) -> list[Region]:
    """The regions as a segmenter gives them that follows objects from frame to frame."""
    return [
        replace(region, segment=replace(region.segment, instance=int(owner)))
        for region, owner in zip(regions, owners, strict=True)
    ]


def same_partition(a: NDArray[np.int64], b: NDArray[np.int64]) -> bool:
    pairs = set(zip(a.tolist(), b.tolist(), strict=True))
    return len(pairs) == len(set(a.tolist())) == len(set(b.tolist()))


FOUR: list[Ball] = [(0.0, 0.0, 0.03), (0.2, 0.05, 0.05), (-0.15, 0.15, 0.04), (-0.1, -0.2, 0.03)]


@pytest.mark.parametrize("name", ASSOCIATORS.names())
def test_contract(name: str) -> None:
    """One id a region, 0..K-1 all used, the true partition, the same twice."""
    frames, regions, truth = capture(FOUR)
    ids = ASSOCIATORS.create(name).associate(regions, frames)
    assert ids.dtype == np.int64 and ids.shape == (len(regions),)
    assert sorted(set(ids.tolist())) == list(range(4))
    assert same_partition(ids, truth)
    assert np.array_equal(ids, ASSOCIATORS.create(name).associate(regions, frames))


@pytest.mark.parametrize("name", ASSOCIATORS.names())
def test_no_region(name: str) -> None:
    frames, _, _ = capture([])
    ids = ASSOCIATORS.create(name).associate([], frames)
    assert ids.shape == (0,) and ids.dtype == np.int64


@pytest.mark.parametrize("name", ASSOCIATORS.names())
def test_single_object(name: str) -> None:
    frames, regions, _ = capture(FOUR[:1])
    assert ASSOCIATORS.create(name).associate(regions, frames).tolist() == [0] * len(frames)


@pytest.mark.parametrize("name", ASSOCIATORS.names())
def test_single_view(name: str) -> None:
    """From one frame, every region is an object of its own."""
    frames, regions, truth = capture(FOUR, views=1)
    assert same_partition(ASSOCIATORS.create(name).associate(regions, frames), truth)


@pytest.mark.parametrize("name", ASSOCIATORS.names())
def test_order_of_regions_does_not_matter(name: str) -> None:
    frames, regions, truth = capture(FOUR)
    order = np.random.default_rng(0).permutation(len(regions))
    ids = ASSOCIATORS.create(name).associate([regions[i] for i in order], frames)
    assert same_partition(ids, truth[order])


def test_oracle_needs_truth() -> None:
    frames, regions, _ = capture(FOUR[:1])
    bare = [Frame(f.index, f.rgb, f.camera, f.depth) for f in frames]
    with pytest.raises(ToolkitError, match="true masks"):
        ASSOCIATORS.create("oracle").associate(regions, bare)


def test_oracle_gives_a_fragment_to_the_object_it_lies_on() -> None:
    frames, regions, truth = capture(FOUR)
    mask = regions[0].segment.mask.copy()
    mask[np.nonzero(mask)[0].min() + 3 :] = False
    fragment = lift_segment(frames[0], Segment(mask))
    assert isinstance(fragment, Region)
    ids = ASSOCIATORS.create("oracle").associate([*regions, fragment], frames)
    assert same_partition(ids, np.append(truth, truth[0]))


@pytest.mark.parametrize("center", ["box", "mean"])
def test_kmeans_finds_k_when_no_frame_shows_everything(center: str) -> None:
    """Every frame misses an object, so the fullest frame shows fewer than there are."""
    hidden = frozenset((v, v % 4) for v in range(6))
    frames, regions, truth = capture(FOUR, hidden=hidden)
    assert max(len(f.true_masks or {}) for f in frames) == 3
    assert same_partition(ASSOCIATORS.create("kmeans", {"center": center}).associate(regions, frames), truth)


def test_kmeans_max_per_frame_merges_then() -> None:
    hidden = frozenset((v, v % 4) for v in range(6))
    frames, regions, _ = capture(FOUR, hidden=hidden)
    ids = ASSOCIATORS.create("kmeans", {"k": "max_per_frame"}).associate(regions, frames)
    assert set(ids.tolist()) == {0, 1, 2}


def test_kmeans_large_object_beside_a_small_one() -> None:
    """Opposite views see opposite sides of the large one, centimetres apart; the small one is nearer than that."""
    frames, regions, truth = capture([(0.0, 0.0, 0.13), (0.155, 0.0, 0.02), (-0.1, 0.25, 0.03)], views=8)
    centroids = np.array([r.centroid for r, o in zip(regions, truth, strict=True) if o == 0])
    assert np.ptp(centroids[:, :2], axis=0).max() > 0.05
    assert same_partition(ASSOCIATORS.create("kmeans").associate(regions, frames), truth)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_kmeans_on_random_layouts(seed: int) -> None:
    """Balls with a centimetre and more between them are told apart, whatever hides what."""
    rng = np.random.default_rng(seed)
    balls: list[Ball] = []
    for _ in range(100):
        x, y, r = *rng.uniform(-0.25, 0.25, 2), rng.uniform(0.025, 0.05)
        if len(balls) < 6 and all(np.hypot(x - a, y - b) > r + c + 0.01 for a, b, c in balls):
            balls.append((float(x), float(y), float(r)))
    frames, regions, truth = capture(balls, views=5)
    assert same_partition(ASSOCIATORS.create("kmeans").associate(regions, frames), truth)


def test_the_scene_is_what_it_says() -> None:
    """Lifted points lie on their ball: the tests above stand on this."""
    frames, regions, truth = capture(FOUR)
    for region, o in zip(regions, truth, strict=True):
        x, y, r = FOUR[o]
        assert np.allclose(np.linalg.norm(region.points - np.array([x, y, r]), axis=1), r, atol=1e-4)
    camera = frames[0].camera
    pixels, _ = project(K, np.linalg.inv(camera.T_world_camera), regions[0].points.astype(np.float64))
    assert np.abs(pixels - regions[0].pixels).max() < 1e-2


def test_kmeans_takes_the_word_of_a_segmenter_that_follows_objects() -> None:
    """Even where it speaks against the places of regions; where one region is not followed, places decide."""
    frames, regions, owners = capture([(0.0, 0.1, 0.04), (0.2, 0.0, 0.05)])
    crossed = np.arange(len(owners)) % 2 + 5
    word = ASSOCIATORS.create("kmeans").associate(followed(regions, crossed), frames)
    assert same_partition(word, crossed) and word[0] == 0
    partly = [*followed(regions[:-1], crossed[:-1]), regions[-1]]
    assert same_partition(ASSOCIATORS.create("kmeans").associate(partly, frames), owners)
