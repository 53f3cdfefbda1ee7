"""Captures in the BOP scene layout. BOP is in millimetres; this module is the only place that knows."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from toolkit.errors import ToolkitError
from toolkit.files import write_json
from toolkit.geometry import invert, is_rigid, make_transform, orthonormalize
from toolkit.types import Camera, Capture, Float, Frame, Image, Mask, ObjectModel, Placed, TrueObject

DEPTH_SCALE = 0.1
"""Millimetres per unit of the depth images that the toolkit writes."""

_RIGID_TOLERANCE = 1e-3
"""Poses rounded in files are this far from orthonormal at most."""

_MASKS_OVERLAP = 0.02
"""Part of the smaller of two masks that may lie in the other: resizing blurs borders."""


def load_capture(folder: Path) -> Capture:
    """Read a capture folder.

    Raises:
        ToolkitError: a file is missing, damaged, or does not fit the others; the message names it.
    """
    current_folder, goal_folder = folder / "current", folder / "goal"
    if not folder.is_dir():
        raise ToolkitError(f"capture '{folder}' does not exist")
    current = _load_frames(current_folder, needs_depth=True)
    goal = _load_frames(goal_folder, needs_depth=False)
    if len(goal) != 1:
        raise ToolkitError(f"'{goal_folder}' must hold exactly one goal image, it holds {len(goal)}")
    if not any(frame.depth is not None and frame.depth.any() for frame in current):
        raise ToolkitError(f"'{current_folder / 'depth'}': every depth image is zero everywhere; nothing was measured")
    truth, only_current, only_goal = _load_truth(folder)
    return Capture(folder.name, tuple(current), goal[0], truth, capture_digest(folder), only_current, only_goal)


def load_models(path: Path) -> dict[int, ObjectModel]:
    """Read models_info.json: object id -> model, in metres.

    Raises:
        ToolkitError: the file is damaged or lacks a key.
    """
    models: dict[int, ObjectModel] = {}
    for key, info in _read_json(path).items():
        try:
            discrete = np.array(info.get("symmetries_discrete", []), np.float64).reshape(-1, 4, 4)
            discrete[:, :3, 3] /= 1e3
            axes = [[*s["axis"], *(v / 1e3 for v in s["offset"])] for s in info.get("symmetries_continuous", [])]
            models[int(key)] = ObjectModel(
                object_id=int(key),
                name=str(info.get("name", f"object {key}")),
                box_min=np.array([info["min_x"], info["min_y"], info["min_z"]], np.float64) / 1e3,
                box_size=np.array([info["size_x"], info["size_y"], info["size_z"]], np.float64) / 1e3,
                diameter=float(info["diameter"]) / 1e3,
                discrete_symmetries=discrete,
                continuous_axes=np.array(axes, np.float64).reshape(-1, 6),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ToolkitError(f"'{path}': object {key} is not as BOP's models_info.json: {error!r}") from error
    return models


def write_capture(
    folder: Path,
    current: Sequence[Frame],
    goal: Frame,
    truth: Mapping[int, TrueObject] | None = None,
    only_current: Mapping[int, Placed] | None = None,
    only_goal: Mapping[int, Placed] | None = None,
) -> None:
    """Write a capture folder that `load_capture` reads back: same poses to the last bit, depth to 0.05 mm.

    Args:
        folder: made when absent.
        current: RGB-D frames of the current scene.
        goal: the goal image.
        truth: true objects in both scenes by instance id; without it no masks, poses and models are written.
        only_current: objects that are not in the goal, by instance id.
        only_goal: objects that are not in the current scene, by instance id.
    """
    true = truth or {}
    now = {i: Placed(o.model, o.T_world_current) for i, o in true.items()} | dict(only_current or {})
    then = {i: Placed(o.model, o.T_world_goal) for i, o in true.items()} | dict(only_goal or {})
    for name, frames, placed in (("current", current, now), ("goal", [goal], then)):
        scene = folder / name
        for sub in ("rgb", "depth") if truth is None else ("rgb", "depth", "mask_visib"):
            (scene / sub).mkdir(parents=True, exist_ok=True)
        write_json(scene / "scene_camera.json", {str(f.index): _camera_json(f.camera) for f in frames})
        for frame in frames:
            _write_frame(scene, frame, list(placed))
        if truth is not None:
            write_json(scene / "scene_gt.json", {str(f.index): _poses_json(f, placed) for f in frames})
    if truth is not None:
        models = {str(o.model.object_id): _model_json(o.model) for o in (now | then).values()}
        write_json(folder / "models_info.json", models)


def _load_frames(scene: Path, *, needs_depth: bool) -> list[Frame]:
    cameras = _read_json(scene / "scene_camera.json")
    if not cameras:
        raise ToolkitError(f"'{scene / 'scene_camera.json'}' lists no image")
    truth = scene / "scene_gt.json"
    instances = {int(k): _instance_ids(v) for k, v in _read_json(truth).items()} if truth.exists() else {}
    frames: list[Frame] = []
    for key in sorted(cameras, key=int):
        frames.append(_load_frame(scene, int(key), cameras[key], instances.get(int(key)), needs_depth))
    return frames


def _load_frame(
    scene: Path, index: int, camera: dict[str, Any], instances: list[int] | None, needs_depth: bool
) -> Frame:
    where = f"'{scene / 'scene_camera.json'}', image {index}"
    rgb_path = _image_path(scene / "rgb", index)
    rgb = cv2.cvtColor(_read_image(rgb_path, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    height, width = rgb.shape[:2]
    try:
        K = np.array(camera["cam_K"], np.float64).reshape(3, 3)
        R = np.array(camera["cam_R_w2c"], np.float64).reshape(3, 3)
        t = np.array(camera["cam_t_w2c"], np.float64).reshape(3) / 1e3
    except (KeyError, ValueError, TypeError) as error:
        raise ToolkitError(f"{where}: cam_K, cam_R_w2c and cam_t_w2c are needed: {error!r}") from error
    expected = (camera.get("width", width), camera.get("height", height))
    if expected != (width, height):
        raise ToolkitError(f"'{rgb_path}' is {width}x{height}, but its camera says {expected[0]}x{expected[1]}")
    if not 0 <= K[0, 2] < width or not 0 <= K[1, 2] < height:
        raise ToolkitError(f"'{rgb_path}' is {width}x{height}, but cam_K has its centre at {K[0, 2]}, {K[1, 2]}")
    pose = _rigid(make_transform(R, t), where)
    try:
        model = Camera(K, invert(pose), width, height)
    except ToolkitError as error:
        raise ToolkitError(f"{where}: {error}") from error
    depth = _load_depth(scene, index, float(camera.get("depth_scale", 1.0)), (height, width), needs_depth)
    masks = None if instances is None else _load_masks(scene, index, instances, (height, width))
    return Frame(index, np.asarray(rgb, np.uint8), model, depth, masks)


def _load_depth(scene: Path, index: int, scale: float, size: tuple[int, int], needed: bool) -> Float | None:
    if not needed:
        return None
    path = _image_path(scene / "depth", index)
    raw = _read_image(path, cv2.IMREAD_UNCHANGED)
    if raw.shape != size:
        raise ToolkitError(f"'{path}' has shape {raw.shape}, but its colour image is {size}")
    return (raw.astype(np.float64) * scale / 1e3).astype(np.float32)


def _load_masks(scene: Path, index: int, instances: list[int], size: tuple[int, int]) -> dict[int, Mask] | None:
    folder = scene / "mask_visib"
    if not folder.is_dir():
        return None
    masks: dict[int, Mask] = {}
    for number, instance in enumerate(instances):
        path = folder / f"{index:06d}_{number:06d}.png"
        raw = _read_image(path, cv2.IMREAD_GRAYSCALE)
        if raw.shape != size:
            raise ToolkitError(f"'{path}' has shape {raw.shape}, but its colour image is {size}")
        if raw.any():
            masks[instance] = raw > 0
    _check_disjoint(masks, folder, index)
    return masks


def _check_disjoint(masks: dict[int, Mask], folder: Path, index: int) -> None:
    total = sum((mask.astype(np.uint16) for mask in masks.values()), np.zeros(1, np.uint16))
    if total.max(initial=0) < 2:
        return
    doubled = total > 1
    for instance, mask in masks.items():
        if (mask & doubled).sum() > _MASKS_OVERLAP * mask.sum():
            raise ToolkitError(f"'{folder}', image {index}: the visible mask of object {instance} overlaps another one")


def _load_truth(folder: Path) -> tuple[dict[int, TrueObject] | None, dict[int, Placed], dict[int, Placed]]:
    """Objects in both scenes, and those in the current scene or in the goal only, by instance id."""
    files = [folder / "models_info.json", folder / "current" / "scene_gt.json", folder / "goal" / "scene_gt.json"]
    if not all(file.exists() for file in files):
        return None, {}, {}
    models = load_models(files[0])
    current, goal = (_load_poses(file, models, files[0]) for file in files[1:])
    truth = {
        i: TrueObject(current[i].model, current[i].T_world_model, goal[i].T_world_model, i)
        for i in sorted(current.keys() & goal.keys())
    }
    only_current, only_goal = (
        {i: a[i] for i in sorted(a.keys() - b.keys())} for a, b in ((current, goal), (goal, current))
    )
    return truth, only_current, only_goal


def _load_poses(path: Path, models: Mapping[int, ObjectModel], models_path: Path) -> dict[int, Placed]:
    """Objects by instance id, from the first image: world poses do not depend on the view."""
    scene = _read_json(path)
    cameras = _read_json(path.with_name("scene_camera.json"))
    key = min(scene, key=int)
    camera = make_transform(
        np.array(cameras[key]["cam_R_w2c"], np.float64).reshape(3, 3), np.array(cameras[key]["cam_t_w2c"]) / 1e3
    )
    T_world_camera = invert(_rigid(camera, f"'{path.with_name('scene_camera.json')}', image {key}"))
    poses: dict[int, Placed] = {}
    for instance, entry in zip(_instance_ids(scene[key]), scene[key], strict=True):
        if "T_world_model" in entry:
            T_world_model = np.array(entry["T_world_model"], np.float64)
        else:
            R = np.array(entry["cam_R_m2c"], np.float64).reshape(3, 3)
            T_world_model = T_world_camera @ _rigid(make_transform(R, np.array(entry["cam_t_m2c"]) / 1e3), f"'{path}'")
        object_id = int(entry["obj_id"])
        if object_id not in models:
            raise ToolkitError(f"'{models_path}' has no object {object_id}, which '{path}' names")
        poses[instance] = Placed(models[object_id], T_world_model)
    return poses


def _instance_ids(entries: list[dict[str, Any]]) -> list[int]:
    """Our `inst_id` where it is given; else the n-th object of one kind in one file is the n-th in the other."""
    if all("inst_id" in entry for entry in entries):
        return [int(entry["inst_id"]) for entry in entries]
    seen: dict[int, int] = {}
    ids: list[int] = []
    for entry in entries:
        kind = int(entry["obj_id"])
        seen[kind] = seen.get(kind, -1) + 1
        ids.append(kind + 100_000 * seen[kind])
    return ids


def _rigid(T: Float, where: str) -> Float:
    if not np.isfinite(T).all():
        raise ToolkitError(f"{where}: the pose is not finite")
    nearest = orthonormalize(T)
    if np.abs(nearest - T).max() > _RIGID_TOLERANCE or not is_rigid(nearest):
        raise ToolkitError(f"{where}: the pose is not rigid (its rotation is not orthonormal)")
    return T if is_rigid(T) else nearest


def _read_json(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text())
    except FileNotFoundError as error:
        raise ToolkitError(f"'{path}' is missing") from error
    except (OSError, ValueError) as error:
        raise ToolkitError(f"'{path}' is not readable JSON: {error}") from error
    if not isinstance(data, dict):
        raise ToolkitError(f"'{path}' must be a JSON object keyed by image or object id")
    return data


def _image_path(folder: Path, index: int) -> Path:
    for suffix in (".png", ".jpg"):
        path = folder / f"{index:06d}{suffix}"
        if path.exists():
            return path
    raise ToolkitError(f"'{folder / f'{index:06d}.png'}' is missing")


def _read_image(path: Path, flags: int) -> Image:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ToolkitError(f"'{path}' cannot be read: {error.strerror}") from error
    # libpng decodes a truncated file without a word, leaving the rest black; its end marker tells.
    whole = b"IEND" in data[-16:] if path.suffix == ".png" else data.rstrip(b"\0")[-2:] == b"\xff\xd9"
    image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data and whole else None
    if image is None:
        raise ToolkitError(f"'{path}' is truncated or not an image")
    return image  # pyright: ignore[reportReturnType]


def capture_digest(folder: Path) -> str:
    """sha256 hex over the names and bytes of every file of a capture folder; nothing is decoded."""
    hasher = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        hasher.update(str(path.relative_to(folder)).encode() + b"\0")
        hasher.update(hashlib.sha256(path.read_bytes()).digest())
    return hasher.hexdigest()


def _camera_json(camera: Camera) -> dict[str, Any]:
    T = invert(camera.T_world_camera)
    return {
        "cam_K": camera.K.ravel().tolist(),
        "depth_scale": DEPTH_SCALE,
        "cam_R_w2c": T[:3, :3].ravel().tolist(),
        "cam_t_w2c": (T[:3, 3] * 1e3).tolist(),
        "width": camera.width,
        "height": camera.height,
    }


def _poses_json(frame: Frame, placed: Mapping[int, Placed]) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = []
    for instance, item in placed.items():
        T = invert(frame.camera.T_world_camera) @ item.T_world_model
        entries.append(
            {
                "cam_R_m2c": T[:3, :3].ravel().tolist(),
                "cam_t_m2c": (T[:3, 3] * 1e3).tolist(),
                "obj_id": item.model.object_id,
                "inst_id": instance,
                # Exact, so that truth scores exactly zero; BOP's own keys carry the rounding of one inversion.
                "T_world_model": item.T_world_model.tolist(),
            }
        )
    return entries


def _model_json(model: ObjectModel) -> dict[str, Any]:
    discrete = model.discrete_symmetries.copy()
    discrete[:, :3, 3] *= 1e3
    info: dict[str, Any] = {"name": model.name, "diameter": model.diameter * 1e3}
    info |= {f"min_{axis}": value * 1e3 for axis, value in zip("xyz", model.box_min.tolist(), strict=True)}
    info |= {f"size_{axis}": value * 1e3 for axis, value in zip("xyz", model.box_size.tolist(), strict=True)}
    if len(discrete):
        info["symmetries_discrete"] = discrete.reshape(-1, 16).tolist()
    if len(model.continuous_axes):
        info["symmetries_continuous"] = [
            {"axis": axis[:3].tolist(), "offset": (axis[3:] * 1e3).tolist()} for axis in model.continuous_axes
        ]
    return info


def _write_frame(scene: Path, frame: Frame, instances: list[int]) -> None:
    _write_png(scene / "rgb" / f"{frame.index:06d}.png", np.ascontiguousarray(frame.rgb[..., ::-1]))
    if frame.depth is not None:
        units = np.rint(frame.depth.astype(np.float64) * 1e3 / DEPTH_SCALE)
        _write_png(scene / "depth" / f"{frame.index:06d}.png", units.clip(0, 65535).astype(np.uint16))
    masks = frame.true_masks or {}
    for number, instance in enumerate(instances):
        mask = masks.get(instance, np.zeros(frame.rgb.shape[:2], bool))
        _write_png(scene / "mask_visib" / f"{frame.index:06d}_{number:06d}.png", mask.astype(np.uint8) * 255)


def _write_png(path: Path, image: np.ndarray) -> None:
    ok, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not ok:
        raise ToolkitError(f"'{path}' cannot be encoded as PNG")
    path.write_bytes(data.tobytes())
