"""What a planner is shown of the table, by one look at it."""

from __future__ import annotations

import numpy as np
from usual import usual_stages

from toolkit.geometry import transform_points
from toolkit.perception.explanation import Explanation, Placement
from toolkit.perception.pipeline import Pipeline
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame, segments_of
from toolkit.rearrangement.sight import SightSettings, look
from toolkit.stages import Explainer


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
    other = next(instance for instance in sight.clouds if instance != item.object)
    assert len(then.obstacles(other)) == len(sight.obstacles(other))
