"""What every retriever must do."""

from __future__ import annotations

from typing import Any

import numpy as np

from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_same_twice


def every_candidate_comes_at_most_once(subject: Subject) -> str:
    """`next(n)` gives at most n rows of the database, none twice, and an empty list when none is left."""
    traversal = _start(subject)
    seen: list[int] = []
    while rows := traversal.next(2):
        require(len(rows) <= 2, f"next(2) gives {len(rows)} rows")
        require(all(isinstance(row, int) for row in rows), "rows must be of type int")
        seen += rows
        traversal.reject(rows[0])
        require(len(seen) <= 24, "it gives more candidates than there are regions")
    require(len(seen) == len(set(seen)), "a candidate comes twice")
    require(set(seen) <= set(range(24)), "a candidate is no row of the database")
    require(seen, "it gives no candidate at all")
    require(traversal.next(1) == [], "an exhausted traversal must go on giving []")
    return f"{len(seen)} of 24 regions"


def asking_in_one_go_gives_what_asking_one_by_one_gives(subject: Subject) -> None:
    """Without rejections, the order does not depend on how many are asked for."""
    together, single = _start(subject).next(24), _start(subject)
    alone: list[int] = []
    while rows := single.next(1):
        alone += rows
    require(together == alone, "next(24) and 24 times next(1) give different candidates")


def objects_do_not_disturb_each_other(subject: Subject) -> None:
    """Traversals of one retriever are independent."""
    retriever = subject.make()
    first, second = (retriever.start(*_problem()) for _ in range(2))
    for row in first.next(3):
        first.reject(row)
    require(second.next(24) == _start(subject).next(24), "what one traversal rejects is missing in another")


def one_region_is_tried(subject: Subject) -> None:
    """A database of one region."""
    traversal = subject.make().start(np.zeros(1, np.int64), np.zeros(1, np.int64), np.array([[0.0, 0, 1]]))
    require(traversal.next(5) == [0], "the only region is not tried")


def the_same_input_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    require_same_twice(lambda: _start(subject).next(24), "the list of candidates")


def _problem() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    observations = rng.standard_normal((24, 3))
    observations /= np.linalg.norm(observations, axis=1, keepdims=True)
    return rng.permutation(24), np.repeat(np.arange(4), 6), observations


def _start(subject: Subject) -> Any:
    return subject.make().start(*_problem())


CHECKS: tuple[Check, ...] = (
    every_candidate_comes_at_most_once,
    asking_in_one_go_gives_what_asking_one_by_one_gives,
    objects_do_not_disturb_each_other,
    one_region_is_tried,
    the_same_input_gives_the_same_bytes,
)
