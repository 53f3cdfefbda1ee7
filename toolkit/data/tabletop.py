"""The tabletop benchmark (Sec. Experiments / Dataset): one scene from its seed and number, whatever else is built."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from toolkit.data import noise
from toolkit.data.bop import write_capture
from toolkit.data.layout import Placement, RestingObject, arrange, resting_poses
from toolkit.data.lookalikes import Lookalikes, with_lookalikes
from toolkit.data.objects import ObjectAsset, ObjectSet
from toolkit.data.table import table_files
from toolkit.errors import ToolkitError
from toolkit.geometry import look_at, make_transform
from toolkit.registry import PluginConfig
from toolkit.sim.bullet import Renderer, best_renderer
from toolkit.sim.client import Client
from toolkit.sim.world import Light, World
from toolkit.types import Camera, Float, Frame, Image, Mask, TrueObject

Effect = Literal["depth", "quantization", "dropout", "color", "light", "pose"]
_TRACKS: dict[str, tuple[Effect, ...]] = {
    "clean": (),
    "d435": ("depth", "quantization", "dropout", "color", "light", "pose"),
}

_CAMERA_DISTANCE_M = 1.05
_ELEVATION = np.radians(45)
_HOME_AZIMUTH = np.radians(-90)
_LOOK_AT = np.array([0.0, 0.0, 0.03])
_BACKGROUND = np.array([96, 100, 104], np.uint8)
_POSE_JITTER_DEG, _POSE_JITTER_M = 0.2, 0.002

# Colour intrinsics as a factory-calibrated D435i reports them, rounded (librealsense, rs-enumerate-devices -c).
_INTRINSICS = {
    "640x480": (616.0, 616.0, 319.5, 239.5, 640, 480),
    "1280x720": (912.0, 912.0, 639.5, 359.5, 1280, 720),
}


class TabletopConfig(PluginConfig):
    """Settings of the tabletop benchmark."""

    objects: str = Field("procedural", description="'procedural', or a folder of scanned objects.")
    scenes: int = Field(150, ge=1, description="Number of scenes.")
    seed: int = Field(0, ge=0, description="Benchmark seed.")
    min_objects: int = Field(1, ge=1, description="Fewest objects a scene.")
    max_objects: int = Field(9, ge=1, description="Most objects a scene.")
    rotation_deg: float = Field(180.0, ge=0, le=180, description="Yaw between goal and current is within +- this.")
    views: int = Field(8, ge=1, le=64, description="Current frames, on a ring; the first is the home view.")
    resolution: Literal["640x480", "1280x720"] = Field("640x480", description="Image size.")
    track: Literal["clean", "d435"] = Field("clean", description="Without noise, or as a RealSense D435 sees it.")
    noise: tuple[Effect, ...] | None = Field(None, description="Only these of the track's effects; all when left out.")
    table: Literal["plain", "wood", "cloth"] = Field("wood", description="What the table looks like.")
    poses: Literal["upright", "stable"] = Field(
        "upright", description="Natural resting pose; or another stable one in the goal than now (6-DoF motions)."
    )
    lookalikes: Lookalikes = Field(
        "none", description="Every second object is the one before it once more: the same, or in other colours."
    )
    radius_m: float = Field(
        0.40, gt=0, le=0.40, description="Objects stand inside this disc; an arm at the edge does not reach all of 0.4."
    )
    clearance_m: float = Field(0.01, ge=0, description="Least gap between objects.")
    renderer: Renderer = Field(
        default_factory=best_renderer,
        description="PyBullet's EGL plug-in where it loads, else TinyRenderer.",
    )
    supersample: int = Field(2, ge=1, le=4, description="TinyRenderer: rendered pixels per pixel and axis.")

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The noise effects that are on."""
        return _TRACKS[self.track] if self.noise is None else self.noise


@dataclass(frozen=True, eq=False)
class TabletopScene:
    """What stands where, before and after.

    Attributes:
        config: the benchmark's settings.
        number: of the scene in the benchmark.
        assets: the objects; an object's position is its instance id.
        current: (4, 4) model to world of every object now.
        goal: the same in the goal scene.
    """

    config: TabletopConfig
    number: int
    assets: tuple[ObjectAsset, ...]
    current: tuple[Float, ...]
    goal: tuple[Float, ...]

    @property
    def truth(self) -> dict[int, TrueObject]:
        """True objects by instance id."""
        poses = zip(self.assets, self.current, self.goal, strict=True)
        return {i: TrueObject(asset.model, current, goal, i) for i, (asset, current, goal) in enumerate(poses)}


def build_scene(config: TabletopConfig, objects: ObjectSet, number: int, folder: Path, cache: Path) -> None:
    """Draw, render and write scene `number` as a capture folder.

    The same settings and number give the same files, in any order and on any number of workers.

    Raises:
        ToolkitError: there are fewer objects than asked for, or the table does not hold them.
    """
    scene = draw_scene(config, objects, number, cache)
    with Studio(scene, cache) as studio:
        goal = studio.goal()
        write_capture(folder, studio.current(scene.current), goal, scene.truth)


class Studio:
    """A scene's objects on their table, and the cameras around it; use it as a context manager.

    Noise comes from the scene's own generator: the same pictures in the same order are the same to the bit.

    Args:
        scene: what to show.
        cache: where the table's files are kept.

    Raises:
        ToolkitError: the renderer does not load here.
    """

    def __init__(self, scene: TabletopScene, cache: Path) -> None:
        self._config = scene.config
        self._goal_poses = scene.goal
        self._rng = _generator(scene.config, scene.number, "noise")
        self._goal_light, self._light = _lights(scene.config, self._rng)
        self._world = World(scene.config.renderer)
        visuals = [(asset.mesh, asset.texture) for asset in scene.assets]
        _, *self._bodies = self._world.add_visuals([table_files(scene.config.table, cache), *visuals])

    def __enter__(self) -> Studio:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the simulator."""
        self._world.close()

    @property
    def client(self) -> Client:
        """The PyBullet client, for what else is to be in its pictures."""
        return self._world.client

    def goal(self) -> Frame:
        """The goal image, from the home view."""
        self._world.move_all(self._bodies, self._goal_poses)
        return self._shoot(0, home_camera(self._config), self._goal_light, depth=False)

    def current(self, poses: Sequence[Float]) -> list[Frame]:
        """RGB-D frames from the predefined views, with every object at its (4, 4) pose."""
        self._world.move_all(self._bodies, poses)
        return [self._shoot(i, c, self._light, depth=True) for i, c in enumerate(ring_cameras(self._config))]

    def picture(self, camera: Camera, poses: Sequence[Float]) -> Image:
        """(H, W, 3) uint8 without noise, for people to look at."""
        self._world.move_all(self._bodies, poses)
        rgb, _, ids = self._world.render(camera, self._light, self._supersample)
        rgb[ids < 0] = _BACKGROUND
        return rgb

    @property
    def _supersample(self) -> int:
        return self._config.supersample if self._config.renderer == "tiny" else 1

    def _shoot(self, index: int, camera: Camera, light: Light, *, depth: bool) -> Frame:
        seen = jitter(camera, self._rng) if "pose" in self._config.effects else camera
        rgb, z, ids = self._world.render(seen, light, self._supersample)
        rgb[ids < 0] = _BACKGROUND
        masks: dict[int, Mask] = {i: ids == body for i, body in enumerate(self._bodies)}
        masks = {i: mask for i, mask in masks.items() if mask.any()}
        rgb, z = _degrade(rgb, z, self._config.effects, self._rng)
        return Frame(index, rgb, camera, z if depth else None, masks)


def home_camera(config: TabletopConfig) -> Camera:
    """The fixed frontal view the goal image is taken from."""
    return _camera(config, _HOME_AZIMUTH)


def filming_camera(config: TabletopConfig) -> Camera:
    """A view from further off and beside the home view, for people."""
    home = home_camera(config)
    return Camera(home.K, look_at(np.array([1.25, 0.85, 0.95]), np.array([0.0, -0.15, 0.25])), home.width, home.height)


def ring_cameras(config: TabletopConfig) -> list[Camera]:
    """The predefined views around the table's centre, evenly spaced; the first is the home view."""
    return [_camera(config, _HOME_AZIMUTH + 2 * np.pi * i / config.views) for i in range(config.views)]


def _camera(config: TabletopConfig, azimuth: float) -> Camera:
    fx, fy, cx, cy, width, height = _INTRINSICS[config.resolution]
    out, up = np.cos(_ELEVATION), np.sin(_ELEVATION)
    eye = _LOOK_AT + _CAMERA_DISTANCE_M * np.array([out * np.cos(azimuth), out * np.sin(azimuth), up])
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return Camera(K, look_at(eye, _LOOK_AT), width, height)


def _generator(config: TabletopConfig, number: int, purpose: str) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence([config.seed, number, *purpose.encode()]))


def draw_scene(config: TabletopConfig, objects: ObjectSet, number: int, cache: Path) -> TabletopScene:
    """Draw what stands where in scene `number`; files of recoloured objects are kept below `cache`.

    Raises:
        ToolkitError: there are fewer objects than asked for, or the table does not hold them.
    """
    rng = _generator(config, number, "layout")
    most = config.max_objects
    if config.min_objects > most:
        raise ToolkitError(f"dataset: min_objects is {config.min_objects}, more than max_objects, {most}")
    if most > len(objects.assets):
        raise ToolkitError(f"dataset: max_objects is {most}, but '{objects.name}' has {len(objects.assets)} objects")
    count = int(rng.integers(config.min_objects, most + 1))
    chosen = sorted(rng.choice(len(objects.assets), count, replace=False).tolist())
    assets = with_lookalikes([objects.assets[i] for i in chosen], config.lookalikes, cache)
    rests = [resting_poses(asset) for asset in assets]
    now = [rest[0] for rest in rests]
    then = [_other(rest, rng) for rest in rests] if config.poses == "stable" else now
    yaws = rng.uniform(-np.pi, np.pi, count)
    turns = np.radians(rng.uniform(-config.rotation_deg, config.rotation_deg, count))
    goal = arrange(then, yaws.tolist(), config.radius_m, config.clearance_m, rng)
    current = arrange(now, (yaws + turns).tolist(), config.radius_m, config.clearance_m, rng)
    return TabletopScene(config, number, assets, _poses(current, now), _poses(goal, then))


def _poses(placements: Sequence[Placement], rests: Sequence[RestingObject]) -> tuple[Float, ...]:
    return tuple(placement.pose(rest) for placement, rest in zip(placements, rests, strict=True))


def _other(rests: list[RestingObject], rng: np.random.Generator) -> RestingObject:
    return rests[int(rng.integers(1, len(rests)))] if len(rests) > 1 else rests[0]


def _lights(config: TabletopConfig, rng: np.random.Generator) -> tuple[Light, Light]:
    """The light over the goal scene and over the current one: the same, unless the track changes it."""
    if "light" not in config.effects:
        return Light(), Light()

    def draw() -> Light:
        x, y = rng.uniform(-0.8, 0.8, 2)
        ambient = rng.uniform(0.45, 0.65)
        return Light((float(x), float(y), 1.0), float(ambient), float(rng.uniform(0.3, 1.0 - ambient)))

    return draw(), draw()


def jitter(camera: Camera, rng: np.random.Generator) -> Camera:
    """Where the camera really is, when its stated pose is off by a calibrated arm's error."""
    turn = Rotation.from_rotvec(rng.normal(0, np.radians(_POSE_JITTER_DEG) / np.sqrt(3), 3)).as_matrix()
    shift = rng.normal(0, _POSE_JITTER_M / np.sqrt(3), 3)
    return Camera(camera.K, camera.T_world_camera @ make_transform(turn, shift), camera.width, camera.height)


def _degrade(
    rgb: np.ndarray, depth: Float, effects: tuple[Effect, ...], rng: np.random.Generator
) -> tuple[np.ndarray, Float]:
    if "depth" in effects:
        depth = noise.axial_noise(depth, rng)
    if "quantization" in effects:
        depth = noise.quantize(depth)
    if "dropout" in effects:
        depth = noise.dropout(depth, rng)
    if "color" in effects:
        rgb = noise.color_noise(rgb, rng)
    return rgb, depth
