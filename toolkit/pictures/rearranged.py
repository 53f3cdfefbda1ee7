"""What became of a scene, as one picture: the goal, the scene before, and after, with every object right or wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from toolkit.data.tabletop import Studio, TabletopScene
from toolkit.pictures.cases import write_case
from toolkit.pictures.drawing import Color, overlay, scaled_to_height, titled, with_legend
from toolkit.results.completion import MoveRow
from toolkit.types import Frame, Image, Mask

_RIGHT, _WRONG, _PLACE = (40, 200, 90), (240, 80, 60), (225, 225, 225)
_LEGEND: dict[str, Color] = {"right": _RIGHT, "wrong": _WRONG, "where a wrong one belongs": _PLACE}


def write_scene(run: Path, scene: TabletopScene, rows: Sequence[MoveRow], cache: Path) -> None:
    """Write one rearranged scene as a picture of a run's report.

    Args:
        run: its folder.
        scene: as it was drawn.
        rows: of all its objects, in one cell.
        cache: where the table's files are kept.

    Raises:
        ToolkitError: the renderer does not load here.
    """
    ended = rows[0].ended
    with Studio(scene, cache) as studio:
        # All by the goal's camera, and in this order, in which the goal is to the bit what the run was given.
        goal = studio.goal()
        before, after = (
            studio.frame(scene.goal_camera, poses)
            for poses in (scene.current, [np.array(ended[number]) for number in range(len(scene.current))])
        )
    write_case(run, f"{scene.number:06d}", rearranged_picture(goal, before, after, rows), _caption(rows))


def rearranged_picture(goal: Frame, before: Frame, after: Frame, rows: Sequence[MoveRow]) -> Image:
    """The goal above the scene before, and beside them, twice as large, what it became, its objects by name.

    Args:
        goal: the goal image, with true masks, as the others.
        before: the scene as it was.
        after: as it stands in the end; all three of one size.
        rows: one per object to outline: green what is right, red what is not, and white its true place.

    Returns:
        (H', W', 3) uint8.
    """
    colors = {row.object: _RIGHT if row.success_sym else _WRONG for row in rows}
    names = {row.object: row.object_name for row in rows}
    goal_masks = goal.true_masks or {}
    wrong = [number for number, color in colors.items() if color == _WRONG and number in goal_masks]
    places = [("", goal_masks[number], _PLACE) for number in wrong]
    large = overlay(after, [], places=[*places, *_outlined(after, names, colors)])
    height = len(large)
    small = [
        titled(scaled_to_height(overlay(frame, [], places=_outlined(frame, {}, colors)), size), title)
        for frame, size, title in ((goal, height // 2, "goal"), (before, height - height // 2, "before"))
    ]
    width = min(picture.shape[1] for picture in small)
    picture = np.hstack([np.vstack([picture[:, :width] for picture in small]), titled(large, "after")])
    return with_legend(picture, list(_LEGEND.items()))


def _outlined(frame: Frame, names: Mapping[int, str], colors: Mapping[int, Color]) -> list[tuple[str, Mask, Color]]:
    """Label, mask and colour of the objects that a frame shows."""
    masks = frame.true_masks or {}
    return [(names.get(number, ""), masks[number], color) for number, color in colors.items() if number in masks]


def _caption(rows: Sequence[MoveRow]) -> str:
    """Every object by name: right, or how far off it is in the end and why."""
    right = [row.object_name for row in rows if row.success_sym]
    wrong = [_off(row) for row in rows if not row.success_sym]
    said = [f"{kind}: {', '.join(names)}" for kind, names in (("right", right), ("wrong", wrong)) if names]
    return f"Scene {rows[0].scene_id}, {'; '.join(said)} ({rows[0].cell})"


def _off(row: MoveRow) -> str:
    off = f"{row.rotation_error_deg_sym:.1f} deg, {row.translation_error_cm_sym:.1f} cm off"
    return f"{row.object_name} ({off}; {row.stage}: {row.reason})"
