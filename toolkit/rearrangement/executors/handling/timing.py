"""From paths to trajectories: as fast as the robot's limits allow, slower near objects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from toolkit.rearrangement.trajectories import Limits, Trajectory
from toolkit.sim.clearance import Clearance
from toolkit.types import Float

_BLEND_RAD = 0.01
"""Corners of a path are cut by so much at most."""


class Timer:
    """Times paths of one arm.

    Args:
        clearance: the arm, and what it keeps clear of.
        limits: of the robot.
        joint_speed: largest speed in free motion, rad/s; the acceleration's limit is lowered in proportion.
        line_speed: the same near objects.
    """

    def __init__(self, clearance: Clearance, limits: Limits, joint_speed: float, line_speed: float) -> None:
        from toolkit.sim.arm_scene import ArmScene  # RoboPlan is not on every machine

        self._clearance = clearance
        self._fast, self._slow = (min(1.0, speed / limits.speed) for speed in (joint_speed, line_speed))
        chain, world = clearance.robot.chain, clearance.world()
        gone = {solid.name for solid in world.solids}
        links = frozenset(pair for pair in world.allowed if gone.isdisjoint(pair))
        self._alone = ArmScene(replace(world, solids=(), allowed=links), chain.lower, chain.upper)
        self._alone.limit(limits.speed, limits.acceleration)

    def line(self, path: Float) -> Trajectory:
        """Along (N, J) points that lie close to each other."""
        return self._timed(path, self._slow, _BLEND_RAD)

    def free(self, path: Float) -> Trajectory:
        """Along an (N, J) path that is free among objects as arranged: its corners are cut where they are free, too."""
        cut = self._timed(path, self._fast, _BLEND_RAD)
        if len(path) == 2 or all(map(self._clearance.free, cut.positions)):
            return cut
        return self._timed(path, self._fast, 0.0)

    def _timed(self, path: Float, part: float, blend: float) -> Trajectory:
        moves = np.concatenate([[True], np.abs(np.diff(path, axis=0)).max(axis=1) > 1e-6])
        if moves.sum() == 1:
            return Trajectory.resting(path[0])
        times, positions, velocities = self._alone.timed(path[moves], part, blend=blend)
        return Trajectory(times=times, positions=positions, velocities=velocities)
