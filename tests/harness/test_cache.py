from __future__ import annotations

import numpy as np
import pytest

from toolkit.digests import digest, source_digest
from toolkit.harness.cache import Cache, CachedDescriptor, CachedMatcher, CachedSegmenter, plugin_identity
from toolkit.perception.crops import crop_region
from toolkit.perception.meter import Meter
from toolkit.stages import DESCRIPTORS, MATCHERS, SEGMENTERS
from toolkit.types import Segment


@pytest.fixture
def crops(capture):
    frame = capture.current[0]
    return [crop_region(frame.rgb, Segment(mask), 96) for mask in frame.true_masks.values()]


def test_digests_tell_values_apart():
    arrays = [np.zeros(2), np.zeros(2, np.float32), np.zeros((2, 1)), [np.zeros(2)]]
    values = [0, 0.5, "0", None, [0], [], {}, True, *arrays]
    assert len({digest(value) for value in values}) == len(values)
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    with pytest.raises(TypeError):
        digest(object())


def test_a_source_digest_covers_what_a_module_imports():
    assert source_digest("toolkit.perception.matchers.sift") != source_digest("toolkit.types")
    retrieval = "toolkit.perception.retrieval"
    assert source_digest(f"{retrieval}.instance_vote") != source_digest(f"{retrieval}.candidates.distance")


def test_entries_come_back_and_damaged_ones_count_as_absent(tmp_path):
    cache = Cache(tmp_path)
    key = digest("some key")
    assert cache.load(key) is None
    cache.store(key, {"a": np.arange(3)})
    np.testing.assert_array_equal(cache.load(key)["a"], [0, 1, 2])
    (entry,) = tmp_path.rglob("*.entry")
    whole = entry.read_bytes()
    for damaged in (b"", whole[:20], whole[:-1], bytes(len(whole)), whole[:-20] + bytes(20)):
        entry.write_bytes(damaged)
        assert cache.load(key) is None
    cache.store(key, {"a": np.arange(3)})
    assert entry.read_bytes() == whole


def test_a_cache_that_cannot_be_written_stops_nothing(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    Cache(blocked / "inside").store("ab", {"a": np.zeros(1)})


def test_settings_and_names_change_the_identity():
    sift = [MATCHERS.create("sift", settings) for settings in ({}, {"ratio": 0.7})]
    other = DESCRIPTORS.create("hog")
    assert len({digest(plugin_identity(p)) for p in (*sift, other)}) == 3


def test_cached_stages_answer_as_the_stages_do(tmp_path, capture, crops):
    meter, cache = Meter(), Cache(tmp_path)
    segmenter, descriptor, matcher = (
        SEGMENTERS.create("oracle"),
        DESCRIPTORS.create("color_hist"),
        MATCHERS.create("sift", {"crop_size": 96}),
    )
    for expect_hit in (False, True):
        meter.take()
        found = CachedSegmenter(segmenter, segmenter, cache, meter).segment(capture.goal, capture.current)
        for a, b in zip(found, segmenter.segment(capture.goal, capture.current), strict=True):
            np.testing.assert_array_equal(a.mask, b.mask)
        vectors = CachedDescriptor(descriptor, descriptor, cache, meter).describe(crops)
        np.testing.assert_array_equal(vectors, descriptor.describe(crops))
        cached = CachedMatcher(matcher, matcher, cache, meter)
        query, *references = cached.extract(crops)
        plain_query, *plain_references = matcher.extract(crops)
        plain = matcher.match(plain_query, plain_references)
        for a, b in zip(cached.match(query, references), plain, strict=True):
            np.testing.assert_array_equal(a.query_xy, b.query_xy)
        assert meter.take()[1] is expect_hit


@pytest.mark.parametrize("instances", [False, True])
def test_which_object_a_mask_is_of_is_kept(tmp_path, capture, instances):
    segmenter = SEGMENTERS.create("masks", {"instances": instances})
    wrapped = CachedSegmenter(segmenter, segmenter, Cache(tmp_path), Meter())
    known = [s.instance for s in segmenter.segment(capture.goal, ())]
    assert known == (sorted(capture.goal.own_masks) if instances else [None] * len(known))
    for _ in range(2):
        assert [s.instance for s in wrapped.segment(capture.goal, ())] == known


def test_an_object_free_image_is_cached_too(tmp_path, capture):
    class Nothing(type(SEGMENTERS.create("oracle"))):
        def segment(self, frame, current):
            return []

    nothing = Nothing()
    wrapped = CachedSegmenter(nothing, nothing, Cache(tmp_path), Meter())
    assert wrapped.segment(capture.goal, ()) == [] == wrapped.segment(capture.goal, ())


def test_a_cached_time_is_the_time_it_once_took(tmp_path, crops):
    descriptor, meter = DESCRIPTORS.create("hog"), Meter()
    wrapped = CachedDescriptor(descriptor, descriptor, Cache(tmp_path), meter)
    wrapped.describe(crops)
    assert meter.take() == ({}, False)
    wrapped.describe(crops)
    times, cached = meter.take()
    assert cached and times["descriptor"] > 0
