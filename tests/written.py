"""A small capture that tests write and then change: three printed boxes on a table, ray-cast, with all its truth."""

from __future__ import annotations

import json
import shutil
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import cv2
import numpy as np

from toolkit.data.bop import write_capture
from toolkit.geometry import make_transform
from toolkit.plugin_kit.conformance.raycast import NOW, THEN
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame
from toolkit.types import Float, ObjectModel, TrueObject

TRUTH_FILES = ("models_info.json", "current/scene_gt.json", "goal/scene_gt.json")


@cache
def _written() -> Path:
    folder = Path(mkdtemp(prefix="toolkit-test-"))
    write_capture(folder, current_frames(), goal_frame(), true_objects(np.eye(4)))
    return folder


def true_objects(T_world_scene: Float) -> dict[int, TrueObject]:
    """The boxes by number, in a world into which (4, 4) `T_world_scene` takes the little scene's."""
    return {number: _true(number, T_world_scene) for number in (1, 2, 3)}


def _true(number: int, T: Float) -> TrueObject:
    (now, size), (then, _) = NOW[number - 1], THEN[number - 1]
    box = np.array(size)
    low = np.array([-box[0] / 2, -box[1] / 2, 0])
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])[None]
    model = ObjectModel(number, f"box {number}", low, box, float(np.linalg.norm(box)), turn, np.zeros((0, 6)))
    return TrueObject(model, *(T @ make_transform(np.eye(3), np.array(at)) for at in (now, then)), number)


def small_capture(folder: Path, *, truth: bool = True) -> Path:
    """The capture, in a folder of its own; without `truth`, masks are all that is known."""
    shutil.copytree(_written(), folder)
    for name in () if truth else TRUTH_FILES:
        (folder / name).unlink()
    return folder


def edit(path: Path, change) -> None:
    """Change what a JSON file holds, in place."""
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def edit_cameras(folder: Path, change) -> None:
    """Change every entry of a scene's scene_camera.json."""
    edit(folder / "scene_camera.json", lambda data: [change(entry) for entry in data.values()])


def rewrite(path: Path, suffix: str, *options: int) -> Path:
    """Store a picture in another format under another suffix."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    path.unlink()
    new = path.with_suffix(suffix)
    new.write_bytes(cv2.imencode(suffix.lower(), image, options)[1].tobytes())
    return new
