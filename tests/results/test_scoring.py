"""Objects that are in one of the two scenes only, and what counts as right for them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from toolkit.data.bop import load_capture, write_capture
from toolkit.geometry import make_transform
from toolkit.results.metrics import counterparts
from toolkit.results.rows import summarize
from toolkit.results.scoring import score
from toolkit.results.tables import motion_table
from toolkit.types import Failure, ObjectModel, Placed, PoseEstimate, Segment, TrueObject


def at(x):
    return make_transform(np.eye(3), np.array([x, 0.0, 0.0]))


def model(kind):
    return ObjectModel(
        kind, f"thing {kind}", np.full(3, -0.03), np.full(3, 0.06), 0.1, np.zeros((0, 4, 4)), np.zeros((0, 6))
    )


def true(kind, x_current, x_goal, instance):
    return TrueObject(model(kind), at(x_current), at(x_goal), instance)


@pytest.fixture
def one_sided(capture, tmp_path):
    """The first scene with object 1 taken out of the current scene's truth, and object 2 out of the goal's."""
    lost = {i: Placed(t.model, t.T_world_goal) for i, t in capture.truth.items() if i == 1}
    left = {i: Placed(t.model, t.T_world_current) for i, t in capture.truth.items() if i == 2}
    kept = {i: t for i, t in capture.truth.items() if i == 0}
    goal_masks = {i: mask for i, mask in capture.goal.true_masks.items() if i != 2}
    frames = [replace(f, true_masks={i: m for i, m in f.true_masks.items() if i != 1}) for f in capture.current]
    write_capture(tmp_path / "scene", frames, replace(capture.goal, true_masks=goal_masks), kept, left, lost)
    return load_capture(tmp_path / "scene")


def estimates(capture, motions):
    said = []
    for number, i in enumerate(sorted(capture.goal.true_masks)):
        T = motions.get(i)
        failure = Failure("retriever", "nothing looks like it") if T is None else None
        said.append(PoseEstimate(number, Segment(capture.goal.true_masks[i]), i, T, failure, confidence=0.8))
    return said


def test_one_sided_objects_are_read_back(one_sided):
    assert (set(one_sided.truth), set(one_sided.only_current), set(one_sided.only_goal)) == ({0}, {2}, {1})
    assert set(one_sided.goal.true_masks) == {0, 1}
    assert all(set(frame.true_masks) <= {0, 2} for frame in one_sided.current)


def test_bop_files_of_others_give_the_same(one_sided, tmp_path):
    for side in ("current", "goal"):
        path = tmp_path / "scene" / side / "scene_gt.json"
        data = json.loads(path.read_text())
        for entry in (entry for entries in data.values() for entry in entries):
            del entry["inst_id"], entry["T_world_model"]
        path.write_text(json.dumps(data))
    plain = load_capture(tmp_path / "scene")
    names = [{o.model.name for o in part.values()} for part in (plain.truth, plain.only_current, plain.only_goal)]
    known = (one_sided.truth, one_sided.only_current, one_sided.only_goal)
    assert names == [{o.model.name for o in part.values()} for part in known]


@pytest.mark.parametrize(
    ("given", "right"), [({0}, {0, 1}), ({0, 1}, {0}), (set(), {1})], ids=["as it is", "false alarm", "nothing said"]
)
def test_what_is_not_there_is_right_without_a_motion_and_wrong_with_one(one_sided, given, right):
    motions = dict.fromkeys(given, one_sided.truth[0].T_goal_current)
    rows = score(one_sided, estimates(one_sided, motions))
    assert {row.object for row in rows if row.success_sym} == right
    assert {row.object: row.in_current for row in rows} == {0: True, 1: False}
    absent = next(row for row in rows if row.object == 1)
    assert absent.rotation_error_deg is None
    assert (absent.T_goal_current is not None) == (1 in given)


def test_false_alarms_are_counted_apart_from_medians(one_sided):
    motions = dict.fromkeys((0, 1), one_sided.truth[0].T_goal_current)
    quiet, alarmed = (
        score(one_sided, estimates(one_sided, {i: motions[i] for i in given}), cell="a") for given in ([0], [0, 1])
    )
    (right,), (wrong,) = summarize(quiet), summarize(alarmed)
    assert (right.objects, right.absent, right.false_alarms.value) == (2, 1, 0.0)
    assert (wrong.objects, wrong.absent, wrong.false_alarms.value) == (2, 1, 1.0)
    assert right.completion_sym.value == 1.0 and wrong.completion_sym.value == 0.0
    for summary in (right, wrong):
        assert summary.rotation_median_deg_sym.value == 0.0 and summary.rotation_p90_deg_sym == 0.0
    assert "false alarms" in motion_table([wrong]).markdown()


def test_without_one_sided_objects_there_is_no_such_column(capture):
    rows = score(capture, estimates(capture, {i: t.T_goal_current for i, t in capture.truth.items()}))
    (summary,) = summarize(rows)
    assert summary.absent == 0 and summary.false_alarms is None
    assert "false alarms" not in motion_table([summary]).markdown()


def test_the_one_that_is_there_may_go_to_either_place_of_its_kind():
    """Two alike in the goal, one of them now: it may go to either, and the other place stays empty."""
    truth = {0: true(7, 0.0, 0.3, 0)}
    missing = {1: Placed(model(7), at(0.5))}
    to_second = counterparts({1: at(0.5)}, truth, None, missing)
    assert to_second[0] is None and to_second[1] is not None
    np.testing.assert_allclose(to_second[1].T_goal_current, at(0.5))
    to_first = counterparts({0: at(0.3)}, truth, None, missing)
    assert to_first[1] is None and to_first[0] is not None
    both = counterparts({0: at(0.3), 1: at(0.5)}, truth, None, missing)
    assert sum(option is None for option in both.values()) == 1


def test_either_of_two_alike_may_go_to_the_one_place():
    truth = {0: true(7, 0.0, 0.3, 0)}
    spare = {1: Placed(model(7), at(0.1))}
    paired = counterparts({0: at(0.2)}, truth, spare)
    np.testing.assert_allclose(paired[0].T_goal_current, at(0.2))
    np.testing.assert_allclose(counterparts({}, truth, spare)[0].T_goal_current, at(0.3))


def test_one_kind_left_and_come_again_is_one_object():
    paired = counterparts({}, {}, {4: Placed(model(3), at(0.0))}, {9: Placed(model(3), at(0.2))})
    assert paired[9] is not None
    np.testing.assert_allclose(paired[9].T_goal_current, at(0.2))
