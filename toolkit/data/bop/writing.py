"""Frames, and the truth where it is known, -> a capture folder."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from toolkit.data.bop.depth import NOT_MEASURED
from toolkit.errors import ToolkitError
from toolkit.files import write_json
from toolkit.geometry import invert
from toolkit.types import Float, Frame, ObjectModel, Placed, TrueObject

_DEPTH_SCALE = 0.1
"""Millimetres per unit of the depth images that the toolkit writes, where that reaches far enough (6.5 m)."""


def write_capture(
    folder: Path,
    current: Sequence[Frame],
    goal: Frame,
    truth: Mapping[int, TrueObject] | None = None,
    only_current: Mapping[int, Placed] | None = None,
    only_goal: Mapping[int, Placed] | None = None,
) -> None:
    """Write a capture folder that `load_capture` reads back: same poses to the last bit.

    Depth is rounded to 0.1 mm, where a frame reaches beyond 6.5 m to 0.2 mm, beyond 13 m to 0.4 mm, and so on.

    Args:
        folder: made when absent.
        current: RGB-D frames of the current scene.
        goal: the goal image.
        truth: true objects in both scenes by instance id; without it no masks, poses and models are written. Masks are
            written where all frames of a scene have them.
        only_current: objects that are not in the goal, by instance id.
        only_goal: objects that are not in the current scene, by instance id.
    """
    true = truth or {}
    now = {i: Placed(o.model, o.T_world_current) for i, o in true.items()} | dict(only_current or {})
    then = {i: Placed(o.model, o.T_world_goal) for i, o in true.items()} | dict(only_goal or {})
    for name, frames, placed in (("current", current, now), ("goal", [goal], then)):
        scene = folder / name
        masked = truth is not None and all(frame.true_masks is not None for frame in frames)
        for sub in ("rgb", "depth", "mask_visib") if masked else ("rgb", "depth"):
            (scene / sub).mkdir(parents=True, exist_ok=True)
        write_json(scene / "scene_camera.json", {str(f.index): _camera_json(f) for f in frames})
        for frame in frames:
            _write_frame(scene, frame, list(placed) if masked else [])
        if truth is not None:
            write_json(scene / "scene_gt.json", {str(f.index): _poses_json(f, placed) for f in frames})
    if truth is not None:
        models = {str(o.model.object_id): _model_json(o.model) for o in (now | then).values()}
        write_json(folder / "models_info.json", models)


def _depth_scale(depth: Float | None) -> float:
    """Millimetres per unit, so that 16 bits reach the farthest point; a power of two times 0.1."""
    reach_mm = (NOT_MEASURED - 1) * _DEPTH_SCALE
    farthest_mm = 0.0 if depth is None else float(depth.max(initial=0)) * 1e3
    return _DEPTH_SCALE * 2 ** max(0, math.ceil(math.log2(farthest_mm / reach_mm))) if farthest_mm else _DEPTH_SCALE


def _camera_json(frame: Frame) -> dict[str, Any]:
    camera = frame.camera
    T = invert(camera.T_world_camera)
    return {
        "cam_K": camera.K.ravel().tolist(),
        "depth_scale": _depth_scale(frame.depth),
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
        units = np.rint(frame.depth.astype(np.float64) * 1e3 / _depth_scale(frame.depth))
        _write_png(scene / "depth" / f"{frame.index:06d}.png", units.astype(np.uint16))
    masks = frame.true_masks or {}
    for number, instance in enumerate(instances):
        mask = masks.get(instance, np.zeros(frame.rgb.shape[:2], bool))
        _write_png(scene / "mask_visib" / f"{frame.index:06d}_{number:06d}.png", mask.astype(np.uint8) * 255)


def _write_png(path: Path, image: np.ndarray) -> None:
    ok, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not ok:
        raise ToolkitError(f"'{path}' cannot be encoded as PNG")
    path.write_bytes(data.tobytes())
