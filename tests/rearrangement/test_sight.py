"""What a planner is shown of the table, by one look at it."""

from __future__ import annotations

import numpy as np
from usual import usual_stages

from toolkit.geometry import make_transform, transform_points
from toolkit.perception.explanation import Explanation, Placement
from toolkit.perception.pipeline import Pipeline
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame, segments_of
from toolkit.rearrangement.moves import Outcome
from toolkit.rearrangement.sight import SightSettings, look
from toolkit.stages import Explainer
from toolkit.types import Failure


class Joining(Explainer):
    """Finds that instances 1 and 0 are one object, which was not moved."""

    def explain(self, task):
        segment, *_ = segments_of(task.goal)
        return Explanation((Placement(1, np.eye(4), segment, 1.0),), (), joined=((1, 0),))


def test_pieces_that_are_one_object_are_planned_as_one():
    apart = look(Pipeline(usual_stages()), current_frames(), goal_frame(), SightSettings())
    as_one = look(Pipeline(usual_stages(explainer=Joining())), current_frames(), goal_frame(), SightSettings())
    assert set(as_one.clouds) == set(apart.clouds) - {0}
    assert {item.object for item in as_one.layout.items} == set(as_one.clouds)
    assert len(as_one.clouds[1]) > max(len(apart.clouds[0]), len(apart.clouds[1]))


def test_all_but_the_object_itself_is_in_the_way_and_what_it_hides_goes_with_it():
    sight = look(Pipeline(usual_stages()), current_frames(), goal_frame(), SightSettings())
    assert set(sight.hidden) == set(sight.clouds)
    everything = sum(len(points) for points in (*sight.clouds.values(), *sight.hidden.values(), sight.unknown))
    for instance, cloud in sight.clouds.items():
        around = sight.obstacles(instance)
        assert len(around) == everything - len(cloud) - len(sight.hidden[instance])
        assert not np.isin(cloud[:, 0], around[:, 0]).all()
    (item, *_) = (item for item in sight.layout.items if item.wanted and len(sight.hidden[item.object]))
    move = item.to_goal()
    then = sight.after(move)
    moved = transform_points(move.T_place_pick, sight.hidden[item.object])
    np.testing.assert_allclose(then.hidden[item.object], moved)
    assert set(sight.empty) == set(sight.clouds)
    np.testing.assert_allclose(then.request(move).empty, transform_points(move.T_place_pick, sight.request(move).empty))
    other = next(instance for instance in sight.clouds if instance != item.object)
    assert len(then.obstacles(other)) == len(sight.obstacles(other))


def test_an_object_is_where_its_move_has_really_left_it():
    sight = look(Pipeline(usual_stages()), current_frames(), goal_frame(), SightSettings())
    item = next(item for item in sight.layout.items if item.wanted)
    move, cloud = item.to_goal(), sight.clouds[item.object]
    lost = Failure("executor", "the object slipped")
    assert sight.after_outcome(move, Outcome(lost)) is sight
    as_asked = sight.after_outcome(move, Outcome(None))
    np.testing.assert_allclose(as_asked.clouds[item.object], transform_points(move.T_place_pick, cloud))
    aside = make_transform(np.eye(3), np.array([0.03, -0.02, 0]))
    for failure in (None, lost):
        then = sight.after_outcome(move, Outcome(failure, T_moved=aside))
        np.testing.assert_allclose(then.clouds[item.object], transform_points(aside, cloud))
        left = then.layout.item(item.object)
        np.testing.assert_allclose(left.footprint.center, item.footprint.center + aside[:2, 3], atol=1e-6)
        assert left.settled == (failure is None)
        np.testing.assert_allclose(left.T_goal_current @ aside, item.T_goal_current)
