"""A plan as it would be carried out, among what was seen: pictures for a film, and a recording for Rerun."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.geometry import invert, lift, look_at, project, transform_points
from toolkit.perception.database import Database
from toolkit.perception.fusion import Clouds
from toolkit.pictures.recording import load_rerun, log_camera, log_picture, log_points, recording, transform
from toolkit.rearrangement.drivers import JointState
from toolkit.rearrangement.plans import ArmPlan, PlannedMove
from toolkit.sim.robot import Robot
from toolkit.sim.robots import RobotModel
from toolkit.sim.world import Light, World
from toolkit.types import Camera, Capture, Float, Frame, Image

_WIDTH, _HEIGHT, _FOCAL_PX = 640, 480, 560.0
_EVERY_PX = 3
"""Of the table, every so many pixels of a frame are shown."""

_DOT_PX = 3
_BACKGROUND = np.array([96, 100, 104], np.uint8)


class DryRun:
    """The robot of a plan among the points of a capture; use it as a context manager. A `Filmable`.

    Args:
        model: the robot.
        plan: what it does.
        capture: what the plan is for.
        database: of its current scene.
        clouds: of all of its instances.
        T_world_table: (4, 4) from the table's own frame, z up.
    """

    on_step: Callable[[], None] | None = None

    def __init__(
        self,
        model: RobotModel,
        plan: ArmPlan,
        capture: Capture,
        database: Database,
        clouds: Clouds,
        T_world_table: Float,
    ) -> None:
        level = invert(T_world_table)
        base = level @ plan.robot.T_world_base
        self._goal = capture.goal
        self._T_world_table = T_world_table
        self._clouds = {i: (transform_points(level, points), colors) for i, (points, colors) in clouds.items()}
        self._moved: dict[int, Float] = {i: np.eye(4) for i in clouds}
        self._current: int | None = None
        self._T_hand_object: Float | None = None
        self._world = World("tiny")
        self._robot = Robot(self._world.client, model, base, pictures=True)
        middle = np.mean([points.mean(axis=0) for points, _ in self._clouds.values()], axis=0)
        self._camera = _from_across(middle, base[:3, 3])
        self._scenery = _drawn(self._camera, *_bare_table(database.level))
        self.moves = 0
        ends = dict(self._moved)
        for move in plan.moves:
            ends[move.object] = level @ move.T_place_pick @ T_world_table @ ends[move.object]
        self._planned = self._picture(ends)[0]

    def __enter__(self) -> DryRun:
        return self

    def __exit__(self, *_: object) -> None:
        self._world.close()

    def begin(self, move: PlannedMove) -> None:
        """From now on the gripper closes on this move's object."""
        self._current = move.object
        self.moves += 1

    def tick(self, state: JointState) -> None:
        """Show the robot in a state; what it holds moves along."""
        self._robot.set(state.positions)
        self._robot.set_drive(self._robot.drive_for(state.opening_m))
        hand = self._robot.T_world_hand()
        if not state.holding or self._current is None:
            self._T_hand_object = None
        elif self._T_hand_object is None:
            self._T_hand_object = invert(hand) @ self._moved[self._current]
        if self._T_hand_object is not None and self._current is not None:
            self._moved[self._current] = hand @ self._T_hand_object
        if self.on_step is not None:
            self.on_step()

    def snapshot(self) -> Image:
        picture, depth = self._picture(self._moved)
        rgb, z, ids = self._world.render(self._camera, Light())
        near = (ids >= 0) & (z < depth)
        picture[near] = rgb[near]
        return picture

    def goal_snapshot(self) -> Image:
        """The table as the plan leaves it, without the robot."""
        return self._planned

    def _picture(self, moved: Mapping[int, Float]) -> tuple[Image, Float]:
        """(H, W, 3) picture of the objects where these (4, 4) motions have taken them, and its (H, W) depth."""
        picture, depth = self._scenery[0].copy(), self._scenery[1].copy()
        for number, (points, colors) in self._clouds.items():
            _draw(picture, depth, self._camera, transform_points(moved[number], points), colors)
        return picture, depth

    def goal_picture(self) -> Image:
        return self._goal.rgb

    def state(self) -> Mapping[int, Float] | None:
        """None: where objects truly are is not known."""
        return None

    @contextmanager
    def recorded(self, path: Path) -> Generator[Callable[[float], None]]:
        """A Rerun recording over the film's time, in the capture's world, for as long as the `with` block lasts.

        `table/<instance>` are the points of every object, which move; `robot` is a line through its joints, and
        `robot/hand` the frame of its hand; `goal` is the goal image.

        Args:
            path: the .rrd file.

        Yields:
            What `Film` calls at every frame.

        Raises:
            ToolkitError: rerun is not installed, or the file cannot be written.
        """
        rr = load_rerun()
        with recording(path, "plan") as stream:
            log_camera(stream, rr, "goal", self._goal.camera)
            log_picture(stream, rr, "goal/rgb", self._goal.rgb)
            for number, (points, colors) in self._clouds.items():
                own = transform_points(self._T_world_table, points)
                log_points(stream, rr, f"table/{number}", own, colors, f"instance {number}")
            yield lambda seconds: self._log(stream, rr, seconds)

    def _log(self, stream: Any, rr: Any, seconds: float) -> None:
        stream.set_time("film", duration=seconds)
        T, back = self._T_world_table, invert(self._T_world_table)
        for number, moved in self._moved.items():
            stream.log(f"table/{number}", transform(rr, T @ moved @ back))
        joints, hand = (T @ frames for frames in self._robot.chain.frames(self._robot.q[None]))
        line = np.concatenate([joints[0, :, :3, 3], hand[:, :3, 3]])
        stream.log("robot", rr.LineStrips3D([line], radii=0.02))
        stream.log("robot/hand", transform(rr, hand[0]))


def _from_across(middle: Float, base: Float) -> Camera:
    """A camera that sees objects around (3,) `middle` and the robot behind them, from the other side and above."""
    ahead = np.array([*(middle - base)[:2], 0.0])
    ahead /= max(float(np.linalg.norm(ahead)), 1e-6)
    aside = np.array([-ahead[1], ahead[0], 0.0])
    K = np.array([[_FOCAL_PX, 0, (_WIDTH - 1) / 2], [0, _FOCAL_PX, (_HEIGHT - 1) / 2], [0, 0, 1]])
    eye = middle + 1.0 * ahead + 0.8 * aside + np.array([0.0, 0.0, 0.9])
    return Camera(K, look_at(eye, (2 * middle + base) / 3 + np.array([0.0, 0.0, 0.15])), _WIDTH, _HEIGHT)


def _bare_table(database: Database) -> tuple[Float, Float]:
    """(N, 3) points and (N, 3) colours of what the frames show besides objects."""
    masks = {frame.index: np.zeros(frame.rgb.shape[:2], bool) for frame in database.frames}
    for region in database.regions:
        masks[region.frame_index] |= region.segment.mask
    parts = [_colored(frame, masks[frame.index]) for frame in database.frames]
    return np.concatenate([points for points, _ in parts]), np.concatenate([colors for _, colors in parts])


def _colored(frame: Frame, without: np.ndarray) -> tuple[Float, Float]:
    assert frame.depth is not None
    kept = np.zeros_like(without)
    kept[::_EVERY_PX, ::_EVERY_PX] = True
    rows, columns = np.nonzero(kept & ~without & (frame.depth > 0))
    pixels = np.stack([columns, rows], axis=1).astype(np.float64)
    points = lift(frame.camera.K, frame.camera.T_world_camera, pixels, frame.depth[rows, columns])
    return points, frame.rgb[rows, columns].astype(np.float64)


def _drawn(camera: Camera, points: Float, colors: Float) -> tuple[Image, Float]:
    """(H, W, 3) picture of points alone, and its (H, W) depth."""
    picture = np.tile(_BACKGROUND, (camera.height, camera.width, 1))
    depth = np.full((camera.height, camera.width), np.inf)
    _draw(picture, depth, camera, points, colors)
    return picture, depth


def _draw(picture: Image, depth: Float, camera: Camera, points: Float, colors: Float) -> None:
    """Draw (N, 3) points with their (N, 3) colours into a picture, where nothing in its depth is nearer."""
    pixels, away = project(camera.K, invert(camera.T_world_camera), points)
    known = np.isfinite(pixels).all(axis=1)
    order = np.flatnonzero(known)[np.argsort(-away[known], kind="stable")]  # of several on one pixel the last stays
    shown = np.clip(np.rint(colors[order]), 0, 255).astype(np.uint8)
    for dx in range(_DOT_PX):
        for dy in range(_DOT_PX):
            x, y = np.rint(pixels[order] + [dx - 1, dy - 1]).astype(np.int64).T
            inside = (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
            x, y, z, rgb = x[inside], y[inside], away[order][inside], shown[inside]
            nearer = z < depth[y, x]
            picture[y[nearer], x[nearer]] = rgb[nearer]
            depth[y[nearer], x[nearer]] = z[nearer]
