"""Which candidates are tried, in which order, what is accepted, and when the search ends."""

from __future__ import annotations

import numpy as np
import pytest
from usual import MANY, Scripted, usual_stages

from toolkit.perception.parts import PipelineSettings
from toolkit.perception.pipeline import Pipeline
from toolkit.perception.search import References, search_candidates
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame, segments_of
from toolkit.stages import PnP, Retriever, Traversal
from toolkit.types import Failure, PnPSolution


class Listed(Retriever, Traversal):
    """Candidates in a given order, and those that were rejected."""

    def __init__(self, rows):
        self.rows, self.rejected = list(rows), []

    def start(self, ranking, instances, observations):
        return self

    def next(self, n):
        taken, self.rows = self.rows[:n], self.rows[n:]
        return taken

    def reject(self, region):
        self.rejected.append(region)


class Choosy(PnP):
    """Solves no problem but those whose turn, from 0, is in `solved`."""

    def __init__(self, solved):
        self.solved, self.turn = solved, -1

    def solve(self, problem, seed):
        self.turn += 1
        good = self.turn in self.solved
        return PnPSolution(np.eye(4), np.ones(len(problem), bool)) if good else Failure("pnp", "not this one")


@pytest.fixture(scope="module")
def database():
    return Pipeline(usual_stages()).build_database(current_frames())


@pytest.fixture(scope="module")
def rows(database):
    """Three regions that are well in view, not in the database's order."""
    sizes = [int(region.segment.mask.sum()) for region in database.regions]
    low, middle, high = sorted(np.argsort(sizes)[-3:].tolist())
    return [high, low, middle]


def search(database, rows, good, solved=(), **settings):
    matcher, retriever = Scripted(good), Listed(rows)
    stages = usual_stages(matcher=matcher, retriever=retriever, pnp=Choosy(solved))
    parts = Pipeline(stages, PipelineSettings(**settings))
    references = References(database, matcher, parts.settings.crop_margin)
    found = search_candidates(parts, references, goal_frame(), segments_of(goal_frame())[0], np.arange(len(database)))
    return found, matcher.batches, retriever.rejected


def test_all_candidates_are_tried_at_once_and_the_good_ones_kept_in_order(database, rows):
    found, batches, rejected = search(database, rows, {0, 2})
    assert [a.row for a in found.accepted] == [rows[0], rows[2]] and rejected == [rows[1]] and batches == [3]
    assert (found.first, found.matcher_calls, found.most_matches) == (rows[0], 3, MANY)
    assert all(len(a.correspondences) == MANY for a in found.accepted)


def test_with_first_they_are_tried_one_by_one_until_one_is_accepted(database, rows):
    found, batches, rejected = search(database, rows, {1, 2}, solved={0}, fuse="first")
    assert [a.row for a in found.accepted] == [rows[1]] and rejected == [rows[0]] and batches == [1, 1]
    assert (found.first, found.matcher_calls) == (rows[0], 2)


def test_with_first_a_candidate_without_a_pose_is_rejected(database, rows):
    found, batches, rejected = search(database, rows, {0, 1, 2}, solved={1}, fuse="first")
    assert [a.row for a in found.accepted] == [rows[1]] and rejected == [rows[0]] and batches == [1, 1]


def test_fewer_matches_than_asked_for_are_not_accepted(database, rows):
    found, _, rejected = search(database, rows[:2], {0}, min_matches=MANY + 1)
    assert not found.accepted and rejected == rows[:2] and found.most_matches == MANY


def test_without_candidates_nothing_is_matched(database):
    found, batches, _ = search(database, [], {0})
    assert (found.accepted, found.first, found.matcher_calls, batches) == ([], None, 0, [])
