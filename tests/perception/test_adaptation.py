"""A descriptor that learns from the scene: its map is applied to the database and to goal objects alike."""

from __future__ import annotations

import numpy as np
from usual import usual_stages

from toolkit.harness.cache import Cache, CachedDescriptor
from toolkit.perception.descriptors.color_hist import ColorHistogram
from toolkit.perception.meter import Meter
from toolkit.perception.pipeline import Pipeline
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame
from toolkit.stages import INDEXES, MATCHERS, AdaptiveDescriptor


class Backwards(ColorHistogram):
    """Learns to turn every row's entries around, which changes no inner product."""

    name = "backwards"

    def adapt(self, rows, instances):
        self.learnt_from = rows, instances
        return lambda given: np.ascontiguousarray(given[:, ::-1])


class Watched:
    """An index that keeps what it is given."""

    def __init__(self):
        self._index = INDEXES.create("numpy")

    def build(self, vectors):
        self.built = vectors
        self._index.build(vectors)

    def search(self, queries, k):
        self.asked = queries
        return self._index.search(queries, k)


def pipeline(descriptor, index):
    matcher = MATCHERS.create("sift", {"crop_size": 128})
    return Pipeline(usual_stages(descriptor=descriptor, index=index, matcher=matcher))


def test_the_map_is_applied_to_database_and_goal_alike():
    learning, plain = Watched(), Watched()
    descriptor = Backwards()
    made = pipeline(descriptor, learning)
    database = made.build_database(current_frames())
    estimates = made.estimate(database, goal_frame())
    expected = pipeline(ColorHistogram(), plain).estimate(database, goal_frame())
    np.testing.assert_array_equal(learning.built, plain.built[:, ::-1])
    np.testing.assert_array_equal(learning.asked, plain.asked[:, ::-1])
    assert descriptor.learnt_from[0] is database.descriptors
    assert descriptor.learnt_from[1].tolist() == database.instances.tolist()
    assert [e.instance for e in estimates] == [e.instance for e in expected]


def test_the_cache_keeps_what_a_descriptor_offers(tmp_path):
    def wrapped(descriptor):
        return CachedDescriptor(descriptor, descriptor, Cache(tmp_path), Meter())

    assert isinstance(wrapped(Backwards()), AdaptiveDescriptor)
    assert not isinstance(wrapped(ColorHistogram()), AdaptiveDescriptor)
