"""Where no single grasp serves both places: the object is stood aside, and taken anew from there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from toolkit.geometry import invert, transform_points
from toolkit.rearrangement.executors.handling.planning import ArmPlanner
from toolkit.rearrangement.footprints import DIRECTIONS, Footprint, planar_motion
from toolkit.rearrangement.moves import Grasp, PickPlace
from toolkit.rearrangement.plans import Way
from toolkit.types import Failure, Float

_GRASPS = 6
"""Grasps at either end that are tried with every place in between."""

_ROOM_M = 0.05
"""Nothing else is this near to a place in between: there is to be room for a hand from all sides."""

_GRID = 8
_PLACES, _APART_M = 4, 0.08
_TURNS = tuple(DIRECTIONS * part // 8 for part in (0, 2, 6, 4))
"""Turns tried, in steps of a footprint: none, a quarter either way, half."""


@dataclass(frozen=True, eq=False)
class Step:
    """An object taken and put down once.

    Attributes:
        T_place_pick: (4, 4) motion from where it then stands to where it is put.
        way: how.
    """

    T_place_pick: Float
    way: Way


def steps_of(planner: ArmPlanner, request: PickPlace, q: Float, seed: int) -> tuple[Step, ...] | Failure:
    """One step to where an object is to be put, or two where no single grasp serves both places.

    The planner then sees the object where the request has it.

    Args:
        planner: of the arm.
        request: the move.
        q: (J,) where the arm is.
        seed: of grasps, IK's starts and the search.
    """
    way = planner.plan(request, q, seed)
    if isinstance(way, Way):
        return (Step(request.T_place_pick, way),)
    steps = _through_a_third_place(planner, request, q, seed)
    planner.see(request)  # not at a place that was tried
    return steps or way


def _through_a_third_place(planner: ArmPlanner, request: PickPlace, q: Float, seed: int) -> tuple[Step, Step] | None:
    wanted = request.T_place_pick
    if not planner.clearance.fits(wanted):
        return None
    here = _taken(planner, request, q, seed)
    there = _taken(planner, request.after(wanted), q, seed) if here else ()
    if not there:
        return None
    reach = planner.reach(seed)
    for T in _places(planner, request):
        planner.see(request)
        first = reach.plan(q, here, T)
        if isinstance(first, Failure):
            continue
        onward = request.after(T)
        planner.see(onward)
        back = invert(onward.T_place_pick)
        again = [replace(grasp, T_world_gripper=back @ grasp.T_world_gripper) for grasp in there]
        second = reach.plan(first.retreat.end, again, onward.T_place_pick)
        if isinstance(second, Way):
            return Step(T, first), Step(onward.T_place_pick, second)
    return None


def _taken(planner: ArmPlanner, request: PickPlace, q: Float, seed: int) -> Sequence[Grasp]:
    """Some grasps that lift an object where it stands, wherever it then goes."""
    grasps = planner.grasps(replace(request, T_place_pick=np.eye(4)), seed)
    return () if isinstance(grasps, Failure) else planner.reach(seed).taken(q, grasps, _GRASPS)


def _places(planner: ArmPlanner, request: PickPlace) -> Iterator[Float]:
    """(4, 4) motions to free places between the arm and both ends, which all lie on the table; the handiest first."""
    chain = planner.clearance.robot.chain
    base = chain.T_base[:2, 3]
    start = Footprint.of(request.points)
    goal = Footprint.of(transform_points(request.T_place_pick, request.points)).center
    a, b = (part.ravel() for part in np.meshgrid(*2 * [np.linspace(0, 1, _GRID + 1)]))
    inside = a + b <= 1
    spots = base + np.stack([a[inside], b[inside]], axis=1) @ np.stack([start.center - base, goal - base])
    handy = np.abs(np.linalg.norm(spots - base, axis=1) - chain.longest / 2)
    others = KDTree(request.others[:, :2]) if len(request.others) else None
    used: list[Float] = []
    for spot in spots[np.argsort(handy, kind="stable")]:
        motions = [planar_motion(start.center, spot - start.center, turn) for turn in _TURNS]
        if any(np.linalg.norm(spot - other) < _APART_M for other in used) or not all(
            _has_room(transform_points(T, request.points), others) for T in motions
        ):
            continue
        yield from motions
        used.append(spot)
        if len(used) == _PLACES:
            return


def _has_room(points: Float, others: KDTree | None) -> bool:
    return others is None or bool(others.query(points[:, :2])[0].min() >= _ROOM_M)
