"""The kit's checks, and objects that only a descriptor that has learnt tells apart."""

import numpy as np
from toolkit_online_descriptor import OnlineDescriptor, OnlineDescriptorConfig

from toolkit.plugin_kit.conformance import Conforms


class TestOnlineDescriptor(Conforms):
    plugin = OnlineDescriptor


def views(seed):
    """(40, 8) rows of five objects seen eight times: they differ in two directions, and vary most in the others."""
    rng = np.random.default_rng(seed)
    objects = np.random.default_rng(0).normal(0, 0.3, (5, 2))
    rows = np.concatenate([np.repeat(objects, 8, axis=0), rng.normal(0, 1, (40, 6))], axis=1)
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32), np.repeat(np.arange(5), 8)


def recall(database, queries, instances):
    return float(np.mean(instances[(queries @ database.T).argmax(axis=1)] == instances))


def test_it_learns_which_directions_tell_objects_apart():
    database, instances = views(1)
    queries, _ = views(2)
    learnt = OnlineDescriptor(OnlineDescriptorConfig(shrinkage=0.01)).adapt(database, instances)
    assert recall(learnt(database), learnt(queries), instances) > recall(database, queries, instances) + 0.15


def test_much_shrinkage_learns_nothing():
    database, instances = views(1)
    learnt = OnlineDescriptor(OnlineDescriptorConfig(shrinkage=1e9)).adapt(database, instances)
    centered = database - np.stack([database[instances == k].mean(axis=0) for k in range(5)]).mean(axis=0)
    expected = centered / np.linalg.norm(centered, axis=1, keepdims=True)
    np.testing.assert_allclose(learnt(database), expected, atol=1e-4)
