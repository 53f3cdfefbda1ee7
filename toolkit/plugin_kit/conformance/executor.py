"""What every executor must do. It moves objects: with a robot behind it, clear its table first."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import numpy as np
import trimesh

from toolkit.data.objects import load_object_set
from toolkit.data.tabletop import TabletopConfig, TabletopScene, draw_scene
from toolkit.geometry import is_rigid, make_transform, transform_points
from toolkit.paths import cache_root
from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_same_twice
from toolkit.rearrangement.episode import begun
from toolkit.rearrangement.moves import Outcome, PickPlace
from toolkit.types import Float, Frame

_RIGHT_M = 0.02
"""How far from where it was to be put an object may stand."""


def it_sees_the_table(subject: Subject) -> str:
    """begin() gives the goal image; observe() RGB-D frames with different indices; state() rigid poses or None."""
    with _begun(subject) as (executor, goal):
        require(isinstance(goal, Frame), f"begin() must give the goal as a Frame, got {type(goal).__name__}")
        frames = executor.observe()
        require(frames and all(isinstance(frame, Frame) for frame in frames), "observe() must give Frames, one or more")
        require(all(frame.depth is not None for frame in frames), "a frame of observe() has no depth")
        require(len({frame.index for frame in frames}) == len(frames), "two frames of observe() have the same index")
        state = executor.state()
        require(state is None or all(is_rigid(T) for T in state.values()), "state() must give rigid (4, 4) poses")
        return f"{len(frames)} frames" + ("" if state is None else f", {len(state)} objects")


def an_object_ends_where_it_is_put(subject: Subject) -> str:
    """Object 0 to a free corner: an Outcome; where it is no failure and the state is known, within 2 cm."""
    with _begun(subject) as (executor, _):
        before = executor.state()
        request = _to_the_corner(before)
        outcome = executor.pick_place(request)
        require(isinstance(outcome, Outcome), f"pick_place() must give an Outcome, got {type(outcome).__name__}")
        require(outcome.seconds >= 0, f"a motion cannot take {outcome.seconds} s")
        executor.home()
        after = executor.state()
        if outcome.failure is not None:
            require(outcome.failure.reason, "the Outcome's Failure has no reason")
            return f"failed: {outcome.failure.reason}"
        if before is not None and after is not None:
            wanted = request.T_place_pick @ before[0]
            off = np.linalg.norm(after[0][:2, 3] - wanted[:2, 3])
            require(off < _RIGHT_M, f"it reports success, and the object stands {100 * off:.1f} cm from its place")
            moved = [i for i in before if i != 0 and np.linalg.norm(after[i][:3, 3] - before[i][:3, 3]) > _RIGHT_M]
            require(not moved, f"object {moved[:1]} was pushed away")
        return "moved"


def picking_nothing_is_a_failure(subject: Subject) -> None:
    """Points where no object stands: an Outcome with a Failure, and nothing moves."""
    with _begun(subject) as (executor, _):
        before = executor.state()
        nowhere = np.random.default_rng(0).uniform(0, 0.03, (200, 3)) + np.array([0.46, -0.46, 0.0])
        outcome = executor.pick_place(PickPlace(nowhere, np.eye(4), np.zeros((0, 3))))
        require(
            outcome.failure is not None and outcome.failure.reason, "picking nothing must be a Failure with a reason"
        )
        after = executor.state()
        if before is not None and after is not None:
            require(all(np.allclose(before[i], after[i], atol=1e-3) for i in before), "picking nothing moves an object")


def it_can_begin_again(subject: Subject) -> None:
    """begin(), close(), begin(): the task starts anew."""
    executor = subject.make()
    states: list[Any] = []
    for _ in range(2):
        executor.begin(_task())
        states.append(executor.state())
        executor.close()
    same = states[0] is None or all(np.allclose(states[0][i], states[1][i], atol=1e-6) for i in states[0])
    require(same, "objects stand elsewhere when the same task is begun again")


def the_same_input_gives_the_same_bytes(subject: Subject) -> None:
    """The same task and moves end in the same state, where that is known."""

    def work() -> object:
        with _begun(subject) as (executor, _):
            outcome = executor.pick_place(_to_the_corner(executor.state()))
            return [outcome, executor.state()]

    require_same_twice(work, "where objects end")


@lru_cache
def _task() -> TabletopScene:
    small = {"scenes": 1, "min_objects": 2, "max_objects": 2, "views": 2, "renderer": "tiny", "supersample": 1}
    config = TabletopConfig.model_validate({**small, "seed": 1})
    return draw_scene(config, load_object_set("procedural", cache_root()), 0, cache_root())


@contextmanager
def _begun(subject: Subject) -> Generator[tuple[Any, Any]]:
    executor = subject.make()
    with begun(executor, _task()) as goal:
        yield executor, goal


def _to_the_corner(state: Mapping[int, Float] | None) -> PickPlace:
    """Object 0 to a corner that scenes leave free."""
    poses = dict(enumerate(_task().current)) if state is None else state
    clouds = [transform_points(poses[i], _vertices(i)) for i in range(len(_task().assets))]
    shift = np.array([*(0.45 - poses[0][:2, 3]), 0.0])
    return PickPlace(clouds[0], make_transform(np.eye(3), shift), np.concatenate(clouds[1:]))


@lru_cache
def _vertices(number: int) -> Float:
    return np.asarray(trimesh.load(_task().assets[number].mesh, force="mesh").vertices)  # pyright: ignore[reportAttributeAccessIssue]


CHECKS: tuple[Check, ...] = (
    it_sees_the_table,
    an_object_ends_where_it_is_put,
    picking_nothing_is_a_failure,
    it_can_begin_again,
    the_same_input_gives_the_same_bytes,
)
