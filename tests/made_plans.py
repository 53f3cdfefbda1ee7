"""A plan for an arm of two joints, made by hand."""

from __future__ import annotations

import numpy as np

from toolkit.rearrangement.plans import ArmPlan, PlannedMove, PlannedRobot, Unplanned, Way
from toolkit.rearrangement.trajectories import Limits, Trajectory

HOME = np.array([0.0, 0.5])
LIMITS = Limits(speed=1.0, acceleration=4.0, effort=20.0)


def between(a, b, seconds=1.0):
    """A trajectory from rest to rest."""
    return Trajectory(times=[0, seconds], positions=[a, b], velocities=np.zeros((2, len(a))))


def plan():
    """One move: over the object, down, up, to the side, down, up; and home."""
    above, at, aside, down = HOME + np.array([[0.3, 0], [0.3, 0.2], [-0.3, 0], [-0.3, 0.2]])
    way = Way(
        T_world_gripper=np.eye(4),
        opening_m=0.06,
        closed_m=0.04,
        to_grasp=between(HOME, above),
        approach=between(above, at),
        lift=between(at, above),
        transfer=between(above, aside),
        lower=between(aside, down),
        retreat=between(down, aside),
    )
    move = PlannedMove(
        object=2, goal_object=0, to="goal", reason="its goal is free", confidence=0.9, T_place_pick=np.eye(4), way=way
    )
    robot = PlannedRobot(name="two", joints=("a", "b"), home=HOME, limits=LIMITS, opens_m=0.08, T_world_base=np.eye(4))
    lost = Unplanned(object=1, goal_object=3, stage="grasp", sentence="there is no room for the fingers")
    return ArmPlan(
        schema=1, capture="made", robot=robot, moves=(move,), to_home=between(aside, HOME), not_planned=(lost,)
    )
