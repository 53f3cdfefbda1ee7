"""A capture folder -> Capture."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

from toolkit.data.bop.images import read_bytes
from toolkit.data.bop.masks import masked_scenes
from toolkit.data.bop.notes import Notes
from toolkit.data.bop.scene import SceneFolder
from toolkit.data.bop.schemas import read_models
from toolkit.data.bop.truth import models_of, placed_objects
from toolkit.errors import ToolkitError
from toolkit.types import Capture, Frame, ObjectModel, Placed, TrueObject


def load_capture(folder: Path, masks: Path | None = None) -> Capture:
    """Read a capture folder.

    Stated distortion is taken out, pictures are turned as EXIF says where their size shows that their cameras are too,
    and a current frame without depth is left out. What was done so, and what was not used, the capture's `notes` say.

    Args:
        folder: in the BOP scene layout.
        masks: a folder with a user's own masks in current/ and goal/, to be used instead of those in mask_visib/.

    Raises:
        ToolkitError: a file is missing, damaged, or does not fit the others; the message names it.
    """
    if not folder.is_dir():
        raise ToolkitError(f"capture '{folder}' does not exist")
    if not (folder / "current").is_dir() and (inside := sorted(folder.glob("*/current"))):
        raise ToolkitError(
            f"'{folder}' is a folder of captures; name one of them, such as '{inside[0].parent}', "
            f"or all: toolkit evaluate {folder}"
        )
    if masks is not None:
        masked_scenes(masks)
    notes = Notes()
    current_scene, goal_scene = (
        SceneFolder.read(folder / name, None if masks is None else masks / name, notes) for name in ("current", "goal")
    )
    current, goal = current_scene.current_frames(notes), _goal(goal_scene, notes)
    truth, only_current, only_goal = _load_truth(folder, current_scene, goal_scene, notes)
    own = [frame for frame in (*current, goal) if frame.own_masks and frame.true_masks is None]
    if own and masks is None:
        notes.add(
            "mask_visib/ holds masks without truth, which only the segmenter 'masks' uses: "
            "--segmenter masks --goal-segmenter masks"
        )
    digest = capture_digest(folder)
    if masks is not None:
        digest = hashlib.sha256(f"{digest} {capture_digest(masks)}".encode()).hexdigest()
    return Capture(folder.name, tuple(current), goal, truth, digest, only_current, only_goal, notes.sentences())


def load_current(folder: Path) -> tuple[tuple[Frame, ...], tuple[str, ...]]:
    """Read a current scene alone: its frames, and the notes that `load_capture` makes; raises as that."""
    notes = Notes()
    frames = SceneFolder.read(folder, None, notes).current_frames(notes)
    return tuple(frames), notes.sentences()


def load_goal(folder: Path) -> tuple[Frame, tuple[str, ...]]:
    """Read a goal scene alone: its image, and the notes that `load_capture` makes; raises as that."""
    notes = Notes()
    goal = _goal(SceneFolder.read(folder, None, notes), notes)
    return goal, notes.sentences()


def capture_digest(folder: Path) -> str:
    """sha256 hex over the names and bytes of every file of a capture folder; nothing is decoded.

    Raises:
        ToolkitError: a file cannot be read.
    """
    hasher = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        hasher.update(str(path.relative_to(folder)).encode(errors="surrogateescape") + b"\0")
        hasher.update(hashlib.sha256(read_bytes(path)).digest())
    return hasher.hexdigest()


def _goal(scene: SceneFolder, notes: Notes) -> Frame:
    if len(scene.cameras) != 1:
        raise ToolkitError(f"'{scene.path}' must hold exactly one goal image, it holds {len(scene.cameras)}")
    return scene.goal_frames(notes)[0]


def _load_truth(
    folder: Path, current_scene: SceneFolder, goal_scene: SceneFolder, notes: Notes
) -> tuple[dict[int, TrueObject] | None, dict[int, Placed], dict[int, Placed]]:
    """Objects in both scenes, and those in the current scene or in the goal only, by instance id."""
    path = folder / "models_info.json"
    if not path.exists() or current_scene.truth is None or goal_scene.truth is None:
        return None, {}, {}
    entries = read_models(path)
    notes.add_unknown_keys(path, entries.values())
    models = models_of(entries, path)
    current, goal = (_placed(scene, models) for scene in (current_scene, goal_scene))
    truth = {
        i: TrueObject(current[i].model, current[i].T_world_model, goal[i].T_world_model, i)
        for i in sorted(current.keys() & goal.keys())
    }
    only_current, only_goal = (
        {i: a[i] for i in sorted(a.keys() - b.keys())} for a, b in ((current, goal), (goal, current))
    )
    return truth, only_current, only_goal


def _placed(scene: SceneFolder, models: Mapping[int, ObjectModel]) -> dict[int, Placed]:
    image = min(scene.cameras)
    assert scene.truth is not None
    return placed_objects(scene.path / "scene_gt.json", image, scene.truth[image], scene.cameras[image], models)
