"""Pictures of what is wrong with a capture: where its frames put the table, and whose texture is where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from toolkit.errors import ToolkitError
from toolkit.files import write_bytes
from toolkit.geometry import transform_points
from toolkit.perception.checks.sighting import Sighting, sight
from toolkit.perception.tabletop.plane import table_homography
from toolkit.perception.tabletop.table import Table, find_table
from toolkit.pictures.drawing import with_legend
from toolkit.types import Camera, Finding, Float, Frame, Image

_PLAN_PX, _GAP_PX = 480, 8
_INK = (225, 225, 225)


def illustrated(
    folder: Path, current: Sequence[Frame], goal: Frame | None, findings: Sequence[Finding]
) -> list[Finding]:
    """Write the pictures that findings are shown by into a folder, which is made for them; their sentences name them.

    Args:
        folder: takes cameras.png and table.png.
        current: the current frames that were checked.
        goal: the goal image that was checked; None where it came to none.
        findings: of `toolkit.perception.checks.capture`.
    """
    named: dict[str | None, Path] = {}
    for kind in sorted({finding.shown for finding in findings if finding.shown is not None}):
        picture = cameras_picture(current) if kind == "cameras" else table_picture(current, goal)
        if picture is not None:
            named[kind] = folder / f"{kind}.png"
            folder.mkdir(parents=True, exist_ok=True)
            write_bytes(named[kind], cv2.imencode(".png", picture[..., ::-1])[1].tobytes())
    return [replace(f, sentence=f"{f.sentence} (see {named[f.shown]})") if f.shown in named else f for f in findings]


def cameras_picture(frames: Sequence[Frame]) -> Image | None:
    """Cameras, and the table that each of them sees, where its pose puts it: from above, and from the side.

    Each frame has a colour. Where poses are right, all tables lie on each other.

    Returns:
        (H, W, 3) uint8; None where no frame shows a table.
    """
    seen = [sighting for sighting in map(sight, frames) if sighting is not None and len(sighting.flat)]
    if not seen:
        return None
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 6), layout="constrained")
    above: Any
    side: Any
    above, side = figure.subplots(1, 2)
    T_table_world = _frame_of(seen[0])
    for number, sighting in enumerate(seen):
        T = T_table_world @ sighting.frame.camera.T_world_camera
        table, eye, ahead = transform_points(T, sighting.flat), T[:3, 3], T[:3, 2]
        for axes, (x, y) in ((above, (0, 1)), (side, (0, 2))):
            color = f"C{number % 10}"
            axes.scatter(table[:, x], table[:, y], s=2, alpha=0.4, color=color, linewidths=0)
            length = 0.2 * np.linalg.norm(eye - table.mean(axis=0))
            axes.annotate(
                "", eye[[x, y]] + length * ahead[[x, y]], eye[[x, y]], arrowprops={"arrowstyle": "->", "color": color}
            )
            axes.annotate(str(sighting.frame.index), eye[[x, y]], color=color, weight="bold", ha="center")
            axes.plot(*eye[[x, y]], ".", color=color)
    for axes, title in ((above, "from above"), (side, "from the side")):
        axes.set(title=f"cameras, and the table that each sees, {title} (m)", aspect="equal")
        axes.set_adjustable("datalim")
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba(), np.uint8)[..., :3]


def table_picture(frames: Sequence[Frame], goal: Frame | None) -> Image | None:
    """The table from above: as the current frames show it, one on top of the other, and as the goal does, by its pose.

    Where poses are right, the left is sharp, and the same texture is at the same place on the right.

    Returns:
        (H, W, 3) uint8; None where no frame shows a table.
    """
    try:
        table = find_table(frames)
    except ToolkitError:
        return None
    views = [_from_above(table, frame.camera, frame.rgb) for frame, _ in table.seen()]
    covered = np.sum([view.any(axis=2, keepdims=True) for view in views], axis=0)
    now = np.sum(views, axis=0, dtype=np.float32) / np.maximum(covered, 1)
    plans = [("current frames", np.rint(now).astype(np.uint8))]
    if goal is not None:
        plans.append(("goal", _from_above(table, goal.camera, goal.rgb)))
    gap = np.zeros((_PLAN_PX, _GAP_PX, 3), np.uint8)
    row = [part for _, plan in plans for part in (plan, gap)][:-1]
    names = " / ".join(name for name, _ in plans)
    return with_legend(np.hstack(row), [(f"the table from above, by the poses: {names}", _INK)])


def _frame_of(sighting: Sighting) -> Float:
    """(4, 4) T_table_world by the first frame that sees the table, the origin in the middle of what it sees."""
    T = sighting.frame.camera.T_world_camera
    up = T[:3, :3] @ sighting.plane.normal
    x = np.cross(T[:3, 1], up)
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > 1e-6 else T[:3, 0]
    R = np.stack([x, np.cross(up, x), up])
    inverse = np.eye(4)
    inverse[:3, :3] = R
    inverse[:3, 3] = -R @ transform_points(T, sighting.flat).mean(axis=0)
    return inverse


def _from_above(table: Table, camera: Camera, rgb: Image) -> Image:
    low, size = table.outline.min(axis=0), float(np.ptp(table.outline, axis=0).max())
    cell = size / _PLAN_PX
    to_plane = np.array([[cell, 0, low[0]], [0, -cell, low[1] + size], [0, 0, 1]])
    to_pixels = table_homography(table.T_world_table, camera) @ to_plane
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(rgb, to_pixels, (_PLAN_PX, _PLAN_PX), flags=flags), np.uint8)
