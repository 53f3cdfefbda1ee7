"""Carry a plan out on an arm that ROS 2 controls: FollowJointTrajectory for the arm, GripperCommand for its gripper.

toolkit plan capture --out plan
python docs/examples/ros2_arm.py plan/plan.json --gripper-open 0.0 --gripper-closed 0.8

Nothing moves before the plan has been carried out on a robot that is not there, and you have typed that the arm may.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory, GripperCommand
from rclpy.action import ActionClient
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState as JointStateMessage
from trajectory_msgs.msg import JointTrajectoryPoint

from toolkit.errors import ToolkitError
from toolkit.rearrangement.drivers import Driver, DriverError, Follow, Grip, JointState
from toolkit.rearrangement.executors.drivers.recorded import Recorded
from toolkit.rearrangement.executors.handling.mover import carry_out_plan
from toolkit.rearrangement.plans import ArmPlan, read_plan
from toolkit.types import Frame

SPIN_S, SERVER_S, CANCEL_S = 0.02, 5.0, 2.0
SUCCEEDED = 4
"""action_msgs/GoalStatus.STATUS_SUCCEEDED."""


class Ros2Arm(Driver):
    """An arm behind two action servers and one topic of joint states.

    Args:
        node: spun by this driver alone.
        plan: names the arm's joints.
        arm: name of the FollowJointTrajectory action.
        gripper: name of the GripperCommand action.
        positions: what the gripper calls opened and closed, in its own unit.
    """

    def __init__(self, node: Any, plan: ArmPlan, arm: str, gripper: str, positions: tuple[float, float]) -> None:
        self._node = node
        self._joints = plan.robot.joints
        self._opens_m, self._positions = plan.robot.opens_m, positions
        self._angles: dict[str, float] = {}
        self._heard: int | None = None
        self._opening_m, self._holding = self._opens_m, None
        self._sent = self._handle = self._result = None
        self._doing: Follow | Grip | None = None
        self._arm = ActionClient(node, FollowJointTrajectory, arm)
        self._gripper = ActionClient(node, GripperCommand, gripper)
        node.create_subscription(JointStateMessage, "/joint_states", self._hear, 10)
        for client, name in ((self._arm, arm), (self._gripper, gripper)):
            if not client.wait_for_server(timeout_sec=SERVER_S):
                raise DriverError(f"no action server answers at {name}; start the controllers, or name another one")
        self._spin_until(lambda: self.state() is not None, SERVER_S)

    def state(self) -> JointState | None:
        if self._heard is None or not all(name in self._angles for name in self._joints):
            return None
        return JointState(
            positions=[self._angles[name] for name in self._joints],
            opening_m=self._opening_m,
            holding=self._holding,
            age_s=(self._now() - self._heard) / 1e9,
        )

    def follow(self, request: Follow) -> None:
        goal = FollowJointTrajectory.Goal()
        goal.trajectory.joint_names = list(self._joints)
        trajectory = request.trajectory
        for seconds, q, velocity in zip(trajectory.times, trajectory.positions, trajectory.velocities, strict=True):
            whole = int(seconds)
            time = Duration(sec=whole, nanosec=int((seconds - whole) * 1e9))
            point = JointTrajectoryPoint(positions=q.tolist(), velocities=velocity.tolist(), time_from_start=time)
            goal.trajectory.points.append(point)
        self._send(self._arm, goal, request)

    def grip(self, request: Grip) -> None:
        opened, closed = self._positions
        goal = GripperCommand.Goal()
        goal.command.position = float(np.interp(request.opening_m, [0, self._opens_m], [closed, opened]))
        goal.command.max_effort = request.effort
        self._send(self._gripper, goal, request)

    def advance(self) -> bool:
        rclpy.spin_once(self._node, timeout_sec=SPIN_S)
        if self._doing is None:
            return False
        if self._handle is None and self._sent.done():
            self._handle = self._sent.result()
            if not self._handle.accepted:
                raise DriverError(f"{self._over().phase}: the controller refuses the goal; its log says why")
            self._result = self._handle.get_result_async()
        if self._result is None or not self._result.done():
            return True
        self._end(self._over(), self._result.result())
        return False

    def picture(self) -> Frame:
        raise DriverError("this driver has no camera; record its topics, and `toolkit capture import ros` reads them")

    def stop(self) -> None:
        """Cancel what goes on: ros2_control then holds the arm where it is."""
        if self._doing is None:
            return
        doing = self._over()
        self._spin_until(self._sent.done, CANCEL_S)
        handle = self._sent.result() if self._sent.done() else None
        if handle is not None and handle.accepted:
            canceled = handle.cancel_goal_async()
            self._spin_until(canceled.done, CANCEL_S)
            if canceled.done():
                return
        raise DriverError(f"{doing.phase}: the controller does not answer the order to stop; use the emergency stop")

    def _hear(self, message: Any) -> None:
        self._angles.update(zip(message.name, message.position, strict=True))
        self._heard = self._now()

    def _send(self, client: Any, goal: Any, request: Follow | Grip) -> None:
        self._handle = self._result = None
        self._doing, self._sent = request, client.send_goal_async(goal)

    def _over(self) -> Follow | Grip:
        """Nothing goes on any more; returns what did."""
        assert self._doing is not None
        doing, self._doing = self._doing, None
        return doing

    def _end(self, request: Follow | Grip, answer: Any) -> None:
        if isinstance(request, Grip):
            # A gripper that meets an object stalls before it is closed: that is what was asked for.
            self._opening_m, self._holding = request.opening_m, bool(request.holds and answer.result.stalled)
        elif answer.status != SUCCEEDED or answer.result.error_code != 0:
            said = answer.result.error_string or f"error {answer.result.error_code}"
            raise DriverError(f"{request.phase}: the controller gave up: {said}")

    def _spin_until(self, done: Callable[[], bool], seconds: float) -> None:
        last = self._now() + seconds * 1e9
        while not done() and self._now() < last:
            rclpy.spin_once(self._node, timeout_sec=SPIN_S)

    def _now(self) -> int:
        return self._node.get_clock().now().nanoseconds


def main(arguments: list[str] | None = None, ask: Callable[[str], str] = input) -> int:
    """Read a plan, show it, ask, and carry it out. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plan", type=Path)
    parser.add_argument("--arm", default="/joint_trajectory_controller/follow_joint_trajectory")
    parser.add_argument("--gripper", default="/robotiq_gripper_controller/gripper_cmd")
    parser.add_argument("--gripper-open", type=float, default=0.0, help="what the gripper calls open, in its own unit")
    parser.add_argument("--gripper-closed", type=float, default=0.8, help="what it calls closed")
    chosen = parser.parse_args(arguments)
    # Ctrl-C is to reach the loop that stops the robot, and not to end ROS below it.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        plan = read_plan(chosen.plan)
        carry_out_plan(plan, Recorded(plan.robot.home))
        print(*plan.in_words(), sep="\n")
        print(f"A dry run of it went well: {plan.seconds:.0f} s of motion. Its film: {chosen.plan.with_suffix('.mp4')}")
        if ask("Type 'move' to let the arm move: ").strip() != "move":
            print("nothing was moved")
            return 1
        node = rclpy.create_node("toolkit_plan")
        driver = Ros2Arm(node, plan, chosen.arm, chosen.gripper, (chosen.gripper_open, chosen.gripper_closed))
        failure = carry_out_plan(plan, driver, lambda move: print(f"object {move.goal_object} ..."))
        print(failure.reason if failure else "done; look again: take a new capture, and plan anew what is left")
        return 1 if failure else 0
    except KeyboardInterrupt:
        sys.stderr.write("stopped: the arm holds where it is\n")
        return 130
    except ToolkitError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
