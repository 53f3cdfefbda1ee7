"""What every index must do."""

from __future__ import annotations

import numpy as np

from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_array, require_same_twice
from toolkit.types import Float


def scores_fall_and_belong_to_their_rows(subject: Subject) -> str:
    """(Q, k) float32 inner products in falling order, and the (Q, k) int64 rows they are of; no row twice."""
    vectors, queries = _vectors()
    index = subject.make()
    index.build(vectors)
    scores, rows = index.search(queries, 10)
    require_array(scores, (len(queries), 10), np.float32, "the scores")
    require_array(rows, (len(queries), 10), np.int64, "the rows")
    require((np.diff(scores, axis=1) <= 1e-6).all(), "scores must fall")
    own = np.take_along_axis(queries @ vectors.T, rows, axis=1)
    require(np.allclose(own, scores, rtol=1e-3, atol=1e-4), "scores must be the inner products with their rows")
    require(all(len(set(row)) == len(row) for row in rows.tolist()), "a row is found twice")
    best = np.sort(queries @ vectors.T, axis=1)[:, :-11:-1]
    return f"recall of the 10 nearest {np.mean(own >= best[:, -1:] - 1e-5):.0%}"


def a_batch_gives_what_single_queries_give(subject: Subject) -> None:
    """A query's answer does not depend on the others."""
    vectors, queries = _vectors()
    index = subject.make()
    index.build(vectors)
    together = index.search(queries, 5)[1]
    alone = np.concatenate([index.search(query[None], 5)[1] for query in queries])
    require(np.array_equal(together, alone), "queries in a batch and alone find different rows")


def it_gives_no_more_than_it_has_and_forgets_what_was_there(subject: Subject) -> None:
    """k above the database's size gives all of it; `build` replaces."""
    vectors = np.eye(5, dtype=np.float32)
    index = subject.make()
    index.build(vectors)
    index.build(vectors[:3])
    scores, rows = index.search(vectors[:1], 10)
    require(scores.shape == rows.shape == (1, 3), f"10 of 3 vectors must be 3, got {rows.shape[1]}")
    require(sorted(rows[0].tolist()) == [0, 1, 2], f"rows must be 0, 1, 2, got {sorted(rows[0].tolist())}")


def one_vector_is_found(subject: Subject) -> None:
    """A database of one row."""
    index = subject.make()
    index.build(np.ones((1, 4), np.float32) / 2)
    require(index.search(np.ones((2, 4), np.float32) / 2, 1)[1].tolist() == [[0], [0]], "the only row is not found")


def the_same_input_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""

    def work() -> object:
        index = subject.make()
        index.build(_vectors()[0])
        return list(index.search(_vectors()[1], 10))

    require_same_twice(work, "the answer")


def _vectors() -> tuple[Float, Float]:
    rng = np.random.default_rng(0)
    vectors, queries = (rng.standard_normal((n, 24)) for n in (40, 7))
    vectors, queries = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (vectors, queries))
    return vectors.astype(np.float32), queries.astype(np.float32)


CHECKS: tuple[Check, ...] = (
    scores_fall_and_belong_to_their_rows,
    a_batch_gives_what_single_queries_give,
    it_gives_no_more_than_it_has_and_forgets_what_was_there,
    one_vector_is_found,
    the_same_input_gives_the_same_bytes,
)
