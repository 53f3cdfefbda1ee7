"""`toolkit plan`: a capture -> plan.json, what an arm would do about it. Nothing moves, and no simulator is asked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.files import writing
from toolkit.geometry import invert
from toolkit.harness.estimate import Answer, estimate_capture, read_capture
from toolkit.harness.experiment import Cell, create_stage, episode_settings
from toolkit.harness.session import Session
from toolkit.pictures.dry_run import DryRun
from toolkit.pictures.film import Film
from toolkit.pictures.recording import has_rerun
from toolkit.progress import Progress
from toolkit.rearrangement.episode import MOST_MOVES
from toolkit.rearrangement.executors.arm import Arm
from toolkit.rearrangement.executors.drivers.recorded import Recorded
from toolkit.rearrangement.executors.handling.mover import carry_out_plan
from toolkit.rearrangement.executors.handling.planning import ArmPlanner, Tools
from toolkit.rearrangement.executors.handling.regrasp import steps_of
from toolkit.rearrangement.moves import Finished, Outcome
from toolkit.rearrangement.plans import PLAN, ArmPlan, PlannedMove, PlannedRobot, Unplanned
from toolkit.rearrangement.sight import Sight, in_sight
from toolkit.rearrangement.stages import Schedule
from toolkit.rearrangement.trajectories import Trajectory
from toolkit.sim.client import Client
from toolkit.sim.robot import Robot
from toolkit.types import Capture, Failure, Float, PoseEstimate

_TICK_S = 0.2
"""Way in the robot's time from one picture of the film to the next: it runs five times as fast as the robot."""


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """What is asked for besides the capture.

    Attributes:
        T_world_base: (4, 4) where the robot stands in the capture's world.
        sure: objects whose confidence is below this are left where they are.
        film: make pictures of the plan.
        masks: a folder of a user's own masks, for the segmenter `masks`.
    """

    T_world_base: Float
    sure: float
    film: bool = True
    masks: Path | None = None


def plan_folder(folder: Path, cell: Cell, out: Path, request: PlanRequest, progress: Progress) -> ArmPlan:
    """Perceive one capture folder as `toolkit estimate` does, and plan what an arm does about it.

    Writes what `toolkit estimate` writes, and OUT/plan.json, OUT/plan.mp4 and, where rerun is installed, OUT/plan.rrd.

    Args:
        folder: the capture.
        cell: the settings to run; its executor is an arm.
        out: where it writes to.
        request: where the robot stands, and which objects are to be moved.
        progress: is told what is being done.

    Raises:
        ToolkitError: as `estimate_folder`; the executor is no arm; or the arm cannot stand there.
    """
    assert cell.rearrange is not None
    planner, executor = (create_stage(cell.rearrange, slot) for slot in ("planner", "executor"))
    if not isinstance(executor, Arm):
        raise ToolkitError(f"a plan is an arm's, and executor '{cell.rearrange.executor.name}' is none; use `arm`")
    tools = executor.tools
    tools.check_ready()
    planner.check_ready()
    session = Session(cell)
    capture = read_capture(folder, progress, request.masks)
    answer = estimate_capture(capture, session, out, progress)
    T_world_table = session.scene.database.T_world_level
    believed = [_believed(estimate, request.sure) for estimate in answer.estimates]
    settings = episode_settings(cell.rearrange)
    sight = in_sight(session.scene, believed, settings, invert(T_world_table))
    progress.now("Planning")
    with closing(Client()) as client:
        arm = ArmPlanner(tools, Robot(client, tools.model, invert(T_world_table) @ request.T_world_base))
        _require_place(arm, sight)
        planned = _plan_moves(sight, planner.start(cell.seed), arm)
    plan = ArmPlan(
        schema=1,
        capture=capture.name,
        robot=_robot(tools, request.T_world_base),
        moves=tuple(_in_world(move, T_world_table) for move in planned.moves),
        to_home=None if isinstance(planned.to_home, Failure) else planned.to_home,
        not_planned=tuple(_not_planned(sight, planned.failures)),
    )
    with writing(f"'{out}'"):
        plan.write(out / PLAN)
        if request.film and plan.moves:
            progress.now("Filming")
            show_plan(plan, tools, capture, answer, T_world_table, out)
    return plan


def show_plan(plan: ArmPlan, tools: Tools, capture: Capture, answer: Answer, T_world_table: Float, out: Path) -> None:
    """Carry a plan out on a robot that is not there, and film it: OUT/plan.mp4 and OUT/plan.rrd."""
    with DryRun(tools.model, plan, capture, answer.database, answer.clouds, T_world_table) as shown:
        driver = Recorded(plan.robot.home, tick_s=_TICK_S, on_tick=shown.tick)
        recording = shown.recorded(out / "plan.rrd") if has_rerun() else nullcontext()
        with recording as on_frame, Film(shown, out / "plan.mp4", every=1, on_frame=on_frame):
            failure = carry_out_plan(plan, driver, shown.begin)
    assert failure is None, "on a robot that is not there, nothing slips"


def _believed(estimate: PoseEstimate, sure: float) -> PoseEstimate:
    """An estimate as it is to be acted upon: without its motion where that is not sure enough."""
    confidence = estimate.confidence
    if estimate.T_goal_current is None or confidence is None or confidence >= sure:
        return estimate
    # Rounded down: what is said to be enough is.
    share = np.floor(100 * confidence) / 100
    reason = f"its motion is right with a probability of {share:.0%}, and {sure:.0%} are asked for; look at it"
    failure = Failure("pose", f"{reason}, and take it by --sure {share:.2f}")
    return replace(estimate, T_goal_current=None, equivalents=None, ambiguity=None, covariance=None, failure=failure)


def _require_place(arm: ArmPlanner, sight: Sight) -> None:
    """The arm is free at its home, and something lies where it may reach.

    Raises:
        ToolkitError: it is not; most likely its base is not where it was said to be.
    """
    robot = arm.clearance.robot
    base, shoulder = robot.T_world_base[:3, 3], robot.chain.T_base[:3, 3]
    where = "say where its base stands in the capture's world with --base"
    if sight.clouds:
        away = min(float(np.linalg.norm(points - shoulder, axis=1).min()) for points in sight.clouds.values())
        reach = robot.chain.longest + float(np.linalg.norm(robot.T_hand_tips(0.0)[:3, 3]))
        if away > reach:
            raise ToolkitError(
                f"no object lies where '{robot.model.name}' can reach: the nearest is {away:.2f} m from its "
                f"shoulder, and stretched out it is {reach:.2f} m long; {where}"
            )
    home, name = np.array(robot.model.home), robot.model.name
    stands = f"with its base {100 * base[2]:.0f} cm above the table's plane"
    seen = np.concatenate([np.zeros((0, 3)), *sight.clouds.values()])
    unseen = np.concatenate([sight.unknown, *sight.hidden.values()])
    arm.clearance.see(np.zeros((0, 3)), seen)
    if not arm.clearance.free(home):
        raise ToolkitError(f"'{name}' touches the table or what stands on it when it is at its home, {stands}; {where}")
    arm.clearance.see(np.zeros((0, 3)), np.concatenate([seen, unseen]))
    if not arm.clearance.free(home):
        raise ToolkitError(
            f"'{name}' reaches at its home into space that no current frame looked into, {stands}; {where}, or add "
            "frames that see the table from the other sides"
        )


@dataclass(frozen=True, eq=False)
class _Planned:
    """What comes of planning, in the table's own frame.

    Attributes:
        moves: in order.
        failures: by instance, why it is not brought to its goal.
        to_home: from where the last move ends.
    """

    moves: list[PlannedMove]
    failures: dict[int, Failure]
    to_home: Trajectory | Failure


def _plan_moves(sight: Sight, schedule: Schedule, arm: ArmPlanner) -> _Planned:
    """Plan one move after the other, as if each succeeded."""
    q = np.array(arm.clearance.robot.model.home)
    moves: list[PlannedMove] = []
    failures: dict[int, Failure] = {}
    confidences = {e.instance: e.confidence for e in sight.estimates if e.goal_object in sight.goal_objects.values()}
    for number in range(MOST_MOVES):
        step = schedule.next(sight.layout)
        if isinstance(step, Finished):
            failures = {**step.failures, **failures}
            break
        asked = sight.request(step)
        steps = steps_of(arm, asked, q, number)
        if isinstance(steps, Failure):
            failures[step.object] = steps
            sight = sight.after_outcome(step, Outcome(steps))
            continue
        failures.pop(step.object, None)
        for count, part in enumerate(steps, 1):
            last = count == len(steps)
            moves.append(
                PlannedMove(
                    object=step.object,
                    goal_object=sight.goal_objects.get(step.object),
                    to=step.to if last else "buffer",
                    reason=step.reason if last else "no single grasp serves both places; it is taken anew from here",
                    confidence=confidences.get(step.object),
                    T_place_pick=part.T_place_pick,
                    way=part.way,
                )
            )
        q, sight = steps[-1].way.retreat.end, sight.after(step)
        arm.see(asked.after(step.T_place_pick))
    return _Planned(moves, failures, arm.to_home(q, len(moves)))


def _robot(tools: Tools, T_world_base: Float) -> PlannedRobot:
    model = tools.model
    return PlannedRobot(
        name=model.name,
        joints=model.arm,
        home=np.array(model.home),
        limits=tools.limits,
        opens_m=model.gripper.stroke_m,
        T_world_base=T_world_base,
    )


def _in_world(move: PlannedMove, T_world_table: Float) -> PlannedMove:
    """A move that was planned in the table's own frame, in the capture's world; joints are the same in both."""
    way = move.way.model_copy(update={"T_world_gripper": T_world_table @ move.way.T_world_gripper})
    T = T_world_table @ move.T_place_pick @ invert(T_world_table)
    return move.model_copy(update={"T_place_pick": T, "way": way})


def _not_planned(sight: Sight, failures: Mapping[int, Failure]) -> Iterator[Unplanned]:
    """One per goal object without a motion, and one per instance that is not brought to its goal."""
    instances = {estimate.goal_object: estimate.instance for estimate in sight.estimates}
    for goal_object, failure in sight.failures.items():
        yield Unplanned(
            object=instances[goal_object], goal_object=goal_object, stage=failure.stage, sentence=failure.reason
        )
    for instance, failure in failures.items():
        goal_object = sight.goal_objects.get(instance)
        yield Unplanned(object=instance, goal_object=goal_object, stage=failure.stage, sentence=failure.reason)
