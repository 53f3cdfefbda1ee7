"""Objects' models, and where they truly are, from models_info.json and scene_gt.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from toolkit.data.bop.poses import rigid, world_to_camera
from toolkit.data.bop.schemas import CameraEntry, ModelEntry, TrueEntry, read_models
from toolkit.errors import ToolkitError
from toolkit.geometry import invert, make_transform
from toolkit.types import Float, ObjectModel, Placed


def load_models(path: Path) -> dict[int, ObjectModel]:
    """Read models_info.json: object id -> model, in metres.

    Raises:
        ToolkitError: the file is damaged, lacks a key, or a value is not as its key says.
    """
    return models_of(read_models(path), path)


def models_of(entries: Mapping[int, ModelEntry], path: Path) -> dict[int, ObjectModel]:
    """Models in metres from what `path` holds; raises ToolkitError where one cannot be."""
    models: dict[int, ObjectModel] = {}
    for number, entry in entries.items():
        turns = np.array(entry.symmetries_discrete, np.float64).reshape(-1, 4, 4)
        turns[:, :3, 3] /= 1e3
        axes = [_axis(axis.axis, axis.offset) for axis in entry.symmetries_continuous]
        try:
            models[number] = ObjectModel(
                object_id=number,
                name=entry.name or f"object {number}",
                box_min=np.array([entry.min_x, entry.min_y, entry.min_z]) / 1e3,
                box_size=np.array([entry.size_x, entry.size_y, entry.size_z]) / 1e3,
                diameter=entry.diameter / 1e3,
                discrete_symmetries=turns,
                continuous_axes=np.array(axes, np.float64).reshape(-1, 6),
            )
        except ToolkitError as error:
            raise ToolkitError(f"'{path}': {error}") from error
    return models


def _axis(direction: tuple[float, ...], offset: tuple[float, ...]) -> list[float]:
    length = np.linalg.norm(direction)
    # Unit axes stay as they are, to the last bit.
    unit = direction if abs(length - 1) < 1e-9 else np.array(direction) / length
    return [*unit, *(value / 1e3 for value in offset)]


def instance_ids(entries: Sequence[TrueEntry]) -> list[int]:
    """Our `inst_id` where it is given; else the n-th object of one kind in one file is the n-th in the other."""
    seen: dict[int, int] = {}
    ids: list[int] = []
    for entry in entries:
        seen[entry.obj_id] = seen.get(entry.obj_id, -1) + 1
        ids.append(entry.obj_id + 100_000 * seen[entry.obj_id] if entry.inst_id is None else entry.inst_id)
    return ids


def placed_objects(
    path: Path, image: int, entries: Sequence[TrueEntry], camera: CameraEntry, models: Mapping[int, ObjectModel]
) -> dict[int, Placed]:
    """Objects by instance id, from one image: world poses do not depend on the view.

    Args:
        path: scene_gt.json, for the answers.
        image: the image's id.
        entries: its objects.
        camera: its camera.
        models: by object id.

    Raises:
        ToolkitError: a model or a pose is missing, or a pose is not rigid.
    """
    poses: dict[int, Placed] = {}
    for number, (instance, entry) in enumerate(zip(instance_ids(entries), entries, strict=True)):
        where = f"'{path}', image {image}, object {number}"
        if entry.obj_id not in models:
            raise ToolkitError(f"{where}: obj_id {entry.obj_id} is not in models_info.json")
        poses[instance] = Placed(models[entry.obj_id], _world_pose(entry, camera, path, image, where))
    return poses


def _world_pose(entry: TrueEntry, camera: CameraEntry, path: Path, image: int, where: str) -> Float:
    if entry.T_world_model is not None:
        return rigid(np.array(entry.T_world_model).reshape(4, 4), where)
    if entry.cam_R_m2c is None or entry.cam_t_m2c is None:
        raise ToolkitError(f"{where}: cam_R_m2c and cam_t_m2c are missing; they are the object's pose in the camera")
    T_camera_world = world_to_camera(camera, f"'{path.with_name('scene_camera.json')}', image {image}")
    pose = make_transform(np.array(entry.cam_R_m2c).reshape(3, 3), np.array(entry.cam_t_m2c) / 1e3)
    return invert(T_camera_world) @ rigid(pose, where)
