"""A pool of rendered object views with depth and pose, drawn once and kept: training never waits for the renderer.

Every frame is a fresh arrangement on the table, seen by a random camera under a random light, so that occlusion,
perspective and what lies around an object are as in the benchmark. Depth and pose relate the views of an object.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.data.layout import RestingObject, arrange, resting_poses
from toolkit.data.objects import ObjectAsset, load_object_set
from toolkit.data.procedural import write_set
from toolkit.data.procedural.families import FAMILIES
from toolkit.data.table import table_files
from toolkit.digests import digest, source_digest
from toolkit.errors import ToolkitError
from toolkit.files import make_once
from toolkit.geometry import invert, look_at
from toolkit.progress import Progress
from toolkit.registry import PluginConfig
from toolkit.sim.bullet import Renderer, best_renderer, require_pybullet
from toolkit.sim.world import Light, World
from toolkit.types import Camera, Float, Image, Mask

_TABLE_RADIUS_M = 0.36
_LOOK_AT = np.array([0.0, 0.0, 0.03])
_WIDTH, _HEIGHT = 640, 480
_BORDER_PX = 8
_MIN_PIXELS = 250
_TABLES = ("plain", "wood", "cloth")

_VERSION = 1
"""Raised when the same settings would give other views."""


class PoolConfig(PluginConfig):
    """Settings of a pool of views."""

    objects_per_family: int = Field(
        default=36, ge=1, description="Number of procedural objects that are drawn for every category."
    )
    objects_per_scene: int = Field(default=12, ge=1, description="Number of objects that stand on the table together.")
    frames: int = Field(
        default=40, ge=2, description="Number of frames of every scene; each has a new arrangement, camera and light."
    )
    elevation_deg: tuple[float, float] = Field(
        default=(28.0, 65.0), description="Range of the camera's elevation, in degrees."
    )
    distance_m: tuple[float, float] = Field(
        default=(0.85, 1.3), description="Range of the camera's distance, in metres."
    )
    focal_px: tuple[float, float] = Field(
        default=(600.0, 950.0), description="Range of the focal length at 640x480, in pixels."
    )
    other_pose: float = Field(
        default=0.15,
        ge=0,
        le=1,
        description="Share of scenes whose objects rest in a stable pose other than the natural one.",
    )
    seed: int = Field(default=0, ge=0, description="Seed of the pool.")
    renderer: Renderer = Field(
        default_factory=best_renderer, description="PyBullet's EGL plug-in where it loads, else TinyRenderer."
    )


@dataclass(frozen=True, eq=False)
class View:
    """One object in one frame, cut out with a border.

    Attributes:
        rgb: (h, w, 3) uint8, with what lies around the object.
        depth: (h, w) float32 metres along z.
        mask: (h, w) bool, the object's visible pixels.
        K: (3, 3) intrinsics of the cut-out.
        T_object_camera: (4, 4) pose of the camera in the object's own coordinates.
        object_id: number of the object in its pool.
        rest: number of the stable pose it rests in.
        azimuth: radians, of the camera around the object, about the vertical of its resting pose.
    """

    rgb: Image
    depth: Float
    mask: Mask
    K: Float
    T_object_camera: Float
    object_id: int
    rest: int
    azimuth: float


@dataclass(frozen=True, eq=False)
class Pool:
    """Views by object.

    Attributes:
        key: differs between pools of other settings or objects.
        names: object names; a view's `object_id` is a position in it.
        views: all views, sorted by object.
    """

    key: str
    names: tuple[str, ...]
    views: tuple[View, ...]

    def by_object(self) -> list[list[int]]:
        """Numbers of every object's views, one list an object."""
        rows: list[list[int]] = [[] for _ in self.names]
        for number, view in enumerate(self.views):
            rows[view.object_id].append(number)
        return rows


def describe(trained: Pool, evaluated: Mapping[str, Pool], samples: str, folder: Path | None) -> str:
    """What a network was trained and evaluated on, in a sentence for its card."""
    what = "procedural objects" if folder is None else f"objects of '{folder.name}'"
    others = ", ".join(f"{name} ({len(p.names)} objects, {len(p.views)} views)" for name, p in evaluated.items())
    return (
        f"{len(trained.names)} {what}, {len(trained.views)} rendered views, {samples}; evaluated on objects"
        f" never trained on: {others}"
    )


def is_held_out(name: str) -> bool:
    """Whether an object is kept out of training: a third of all names, which never changes."""
    return hashlib.sha256(f"held out: {name}".encode()).digest()[0] % 3 == 0


def training_pool(config: PoolConfig, folder: Path | None, cache: Path, progress: Progress, *, held_out: bool) -> Pool:
    """The pool of the objects trained on, or of those held out, of a folder of scans; of procedural ones where None.

    Raises:
        ToolkitError: the folder is not one of scans, or has too few objects.
    """
    if folder is None:
        return procedural_pool(config, cache, progress, held_out=held_out)
    assets = [a for a in load_object_set(str(folder), cache).assets if is_held_out(a.name) == held_out]
    if len(assets) < 2:
        use = "held out, as a third of all names is" if held_out else "left to train on, since a third is held out"
        raise ToolkitError(f"only {len(assets)} of the objects in '{folder}' are {use}; put more objects there")
    return _cached(config, assets, cache, progress, "held-out" if held_out else "training")


def procedural_pool(config: PoolConfig, cache: Path, progress: Progress, *, held_out: bool) -> Pool:
    """The pool of the procedural objects trained on, or of those held out; rendered below `cache` when absent."""
    counts = dict.fromkeys(FAMILIES, config.objects_per_family)
    name = f"training-{config.objects_per_family}-{source_digest('toolkit.data.procedural')[:16]}"
    objects = make_once(cache / "objects" / name, lambda folder: write_set(folder, counts))
    assets = [a for a in load_object_set(str(objects), cache).assets if is_held_out(a.name) == held_out]
    return _cached(config, assets, cache, progress, "held-out" if held_out else "training")


def folder_pool(config: PoolConfig, folder: Path, cache: Path, progress: Progress) -> Pool:
    """The pool of a folder of scans, for evaluation only; rendered below `cache` when absent."""
    return _cached(config, load_object_set(str(folder), cache).assets, cache, progress, "scans")


def _cached(config: PoolConfig, assets: Sequence[ObjectAsset], cache: Path, progress: Progress, title: str) -> Pool:
    if len(assets) < 2:
        raise ToolkitError(f"the {title} pool has {len(assets)} objects; raise pool.objects_per_family")
    files = [hashlib.sha256(a.mesh.read_bytes() + a.texture.read_bytes()).hexdigest() for a in assets]
    key = digest([_VERSION, config.model_dump(mode="json"), files])[:16]
    return _read(
        make_once(
            cache / "training-pools" / f"{title}-{key}",
            lambda folder: _render(config, assets, cache, folder, progress, title),
        )
    )


def _render(
    config: PoolConfig, assets: Sequence[ObjectAsset], cache: Path, folder: Path, progress: Progress, title: str
) -> None:
    require_pybullet()
    rng = np.random.default_rng(np.random.SeedSequence([config.seed, *title.encode()]))
    order = rng.permutation(len(assets)).tolist()
    size = config.objects_per_scene
    scenes = [order[i : i + size] for i in range(0, len(order), size)]
    views: list[View] = []
    with progress.step(f"Rendering {title} views", len(scenes) * config.frames) as advance:
        for scene in scenes:
            table = table_files(_TABLES[int(rng.integers(len(_TABLES)))], cache)
            rests = [resting_poses(assets[i]) for i in scene]
            with World(config.renderer) as world:
                _, *bodies = world.add_visuals([table, *((assets[i].mesh, assets[i].texture) for i in scene)])
                for _ in range(config.frames):
                    views += _frame(config, world, bodies, scene, rests, rng)
                    advance(1)
    views.sort(key=lambda view: view.object_id)
    _write(folder, [asset.name for asset in assets], views)


def _frame(
    config: PoolConfig,
    world: World,
    bodies: Sequence[int],
    scene: Sequence[int],
    rests: Sequence[list[RestingObject]],
    rng: np.random.Generator,
) -> list[View]:
    """One frame's cut-outs: as many of the scene's objects as the table holds, anywhere on it."""
    numbers = [int(rng.integers(1, len(r))) if rng.random() < config.other_pose and len(r) > 1 else 0 for r in rests]
    resting = [r[k] for r, k in zip(rests, numbers, strict=True)]
    yaws = rng.uniform(-np.pi, np.pi, len(scene)).tolist()
    shown = list(range(len(scene)))
    while True:
        try:
            placed = arrange([resting[i] for i in shown], [yaws[i] for i in shown], _TABLE_RADIUS_M, 0.005, rng)
            break
        except ToolkitError:
            shown.pop(int(rng.integers(len(shown))))
    poses = {i: placement.pose(resting[i]) for i, placement in zip(shown, placed, strict=True)}
    away = np.eye(4)
    away[2, 3] = -50.0
    world.move_all(bodies, [poses.get(i, away) for i in range(len(scene))])
    camera = _camera(config, rng)
    x, y = rng.uniform(-0.9, 0.9, 2)
    ambient = rng.uniform(0.4, 0.7)
    light = Light((float(x), float(y), 1.0), float(ambient), float(rng.uniform(0.25, 1.0 - ambient)))
    rgb, depth, ids = world.render(camera, light, 2 if config.renderer == "tiny" else 1)
    views: list[View] = []
    for i, T_world_object in poses.items():
        mask = ids == bodies[i]
        if mask.sum() < _MIN_PIXELS:
            continue
        toward = camera.T_world_camera[:2, 3] - T_world_object[:2, 3]
        azimuth = float(np.arctan2(toward[1], toward[0]) - yaws[i])
        T = invert(T_world_object) @ camera.T_world_camera
        views.append(_cut(rgb, depth, mask, camera, T, scene[i], numbers[i], azimuth))
    return views


def _camera(config: PoolConfig, rng: np.random.Generator) -> Camera:
    azimuth, elevation = rng.uniform(-np.pi, np.pi), np.radians(rng.uniform(*config.elevation_deg))
    out, up = np.cos(elevation), np.sin(elevation)
    direction = np.array([out * np.cos(azimuth), out * np.sin(azimuth), up])
    focal = rng.uniform(*config.focal_px)
    K = np.array([[focal, 0, (_WIDTH - 1) / 2], [0, focal, (_HEIGHT - 1) / 2], [0, 0, 1]])
    eye = _LOOK_AT + rng.uniform(*config.distance_m) * direction
    return Camera(K, look_at(eye, _LOOK_AT), _WIDTH, _HEIGHT)


def _cut(
    rgb: Image, depth: Float, mask: Mask, camera: Camera, T: Float, object_id: int, rest: int, azimuth: float
) -> View:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    y0, x0 = max(rows[0] - _BORDER_PX, 0), max(columns[0] - _BORDER_PX, 0)
    box = np.s_[y0 : rows[-1] + 1 + _BORDER_PX, x0 : columns[-1] + 1 + _BORDER_PX]
    K = camera.K - np.array([[0, 0, x0], [0, 0, y0], [0, 0, 0]])
    return View(rgb[box], depth[box], mask[box], K, T, object_id, rest, azimuth)


def _write(folder: Path, names: Sequence[str], views: Sequence[View]) -> None:
    """Pixels of all views end to end, so that a pool is six arrays that load in a moment."""
    arrays = {
        "rgb": np.concatenate([v.rgb.reshape(-1, 3) for v in views]),
        "depth": np.concatenate([v.depth.ravel() for v in views]),
        "mask": np.concatenate([v.mask.ravel() for v in views]),
        "sizes": np.array([v.mask.shape for v in views]),
        "cameras": np.stack([np.concatenate([v.K.ravel(), v.T_object_camera.ravel()]) for v in views]),
        "labels": np.array([[v.object_id, v.rest] for v in views]),
        "azimuths": np.array([v.azimuth for v in views]),
    }
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array, allow_pickle=False)
    (folder / "names.json").write_text(json.dumps(list(names)))


def _read(folder: Path) -> Pool:
    def array(name: str) -> NDArray[Any]:
        return np.load(folder / f"{name}.npy", mmap_mode="r", allow_pickle=False)

    rgb, depth, mask = (array(name) for name in ("rgb", "depth", "mask"))
    sizes, cameras, labels, azimuths = (np.asarray(array(n)) for n in ("sizes", "cameras", "labels", "azimuths"))
    ends = np.cumsum(sizes.prod(axis=1))
    views: list[View] = []
    for i, end in enumerate(ends.tolist()):
        h, w = sizes[i].tolist()
        span = slice(end - h * w, end)
        views.append(
            View(
                rgb[span].reshape(h, w, 3),
                depth[span].reshape(h, w),
                mask[span].reshape(h, w),
                cameras[i, :9].reshape(3, 3),
                cameras[i, 9:].reshape(4, 4),
                int(labels[i, 0]),
                int(labels[i, 1]),
                float(azimuths[i]),
            )
        )
    return Pool(folder.name, tuple(json.loads((folder / "names.json").read_text())), tuple(views))
