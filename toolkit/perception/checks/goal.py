"""The goal image against the current frames: does its camera see the table, and is the table where its pose says?"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.perception.checks.likeness import PATCHES, Plan, bare_plans, between, likeness, plan
from toolkit.perception.checks.suspects import AXES, CAM_K, FLIPS, SIZES, STORE, Suspect, rescaled, resized
from toolkit.perception.tabletop.table import Table
from toolkit.types import Finding, Float, Frame

_LEAST_SHARE, _SMALL_SHARE, _FAIR_SHARE = 0.02, 0.1, 0.3
"""Parts of the goal image that show the table: with less nothing can be found, or little, or all may be well."""

_UNLIKE, _LIKE = 0.15, 0.5
"""Correlations of the table's texture: a table elsewhere is below the one, the same table above the other."""

_STRANGE, _FAMILIAR = 0.2, 0.1
"""Parts of the current frames' patches that no other frame has: with colours flipped against depth, and without."""

_DOUBT, _LITTLE = 0.3, 0.5

_SURER = 2.0
"""A pose is taken for a mistake where the one that was meant shows a table this many times as alike."""

_UNITS = tuple(
    Suspect(rescaled(factor), f"its pose looks like one in {unit}", "cam_t_w2c is in millimetres")
    for factor, unit in ((1000.0, "metres"), (10.0, "centimetres"))
)


def _upright(quarter: float) -> Suspect:
    T = np.eye(4)
    T[1:3, 1:3] = [[0, -quarter], [quarter, 0]]
    cause = "its pose looks like one in a world with another axis up, y for z"
    return Suspect(lambda pose: T @ pose, cause, "give the goal in the world of the current frames")


_WORLDS = tuple(map(_upright, (1.0, -1.0)))


def check_table(goal: Frame, table: Table, T_world_frames: Float | None = None) -> list[Finding]:
    """Compare a goal image with the table that the current frames show.

    Args:
        goal: in the same frame of reference as the table's frames.
        table: of the current frames.
        T_world_frames: (4, 4) from there into the world in which the poses were written down, since a mistake in
            writing is undone only there; None where that is it.
    """
    T = np.eye(4) if T_world_frames is None else T_world_frames
    return [replace(finding, shown="table") for finding in _compared(goal, table, T)]


def _compared(goal: Frame, table: Table, T_world_frames: Float) -> list[Finding]:
    plans = bare_plans(table)
    own = between(plans)
    for how, axes in FLIPS.items() if _strange(own) > _STRANGE else ():
        # A table that shines or is all noise looks different in every frame, however they are flipped.
        if _strange(between(bare_plans(table, axes))) < _FAMILIAR:
            return [Finding("refused", f"the current colour images are {how}, and their depth is not; {STORE}")]
    share = float(table.surface(goal.camera).mean())
    alike = _likeness(goal, table, plans)
    textured = len(alike) >= PATCHES
    likely = float(np.median(alike)) if textured else 0.0
    if likely > _LIKE or (not textured and share > _FAIR_SHARE):
        return []
    blind = f"the goal image shows {'no' if share < _LEAST_SHARE else 'another'} table, by its pose"
    mistakes = [(_median(meant, table, plans), sentence) for sentence, meant in _meant(goal, table, T_world_frames)]
    # Several may come close where the cameras' axes are parallel to the world's.
    best, mistake = max(mistakes, key=lambda found: found[0])
    if best > max(_LIKE, _SURER * likely):
        return [Finding("refused", f"{blind}, and {mistake}")]
    if likely > _UNLIKE:
        return []
    if share < _LEAST_SHARE:
        remedy = "is goal/scene_camera.json in the same world, axes and units as current/scene_camera.json?"
        return [Finding("refused", f"{blind}; {remedy}")]
    for how, axes in FLIPS.items():
        if _median(replace(goal, rgb=np.flip(goal.rgb, axes)), table, plans) > _LIKE:
            return [Finding("refused", f"the goal image is {how}; {STORE}")]
    # So is it in the current frames where it shines, or is all noise.
    if textured and (len(own) < PATCHES or np.median(own) > _LIKE):
        sentence = "the texture of the table is elsewhere in the goal image than its pose says"
        causes = "is that the pose of this image, and are the current poses not one image off?"
        return [Finding("doubtful", f"{sentence}; {causes}", _DOUBT)]
    if share < _SMALL_SHARE:
        sentence = f"only {share:.0%} of the goal image shows the table, by its pose; point the camera at it"
        return [Finding("doubtful", sentence, _LITTLE)]
    return []


def _strange(alike: Float) -> float:
    """0..1: part of the textured patches that no other frame has; neither much nor little where few are compared."""
    return float((alike < _LIKE).mean()) if len(alike) >= PATCHES else 0.5 * (_STRANGE + _FAMILIAR)


def _meant(goal: Frame, table: Table, T_world_frames: Float) -> Iterator[tuple[str, Frame]]:
    """What people often write down wrongly: cause and remedy in a sentence, and the goal as it was meant then."""
    for suspect in (*AXES, *_UNITS, *_WORLDS):
        # A camera that would be too far away for one was not meant.
        with suppress(ToolkitError):
            camera = replace(goal.camera, T_world_camera=_undone(suspect, goal, table, T_world_frames))
            yield suspect.sentence, replace(goal, camera=camera)
    for factor, size in SIZES.items():
        sentence = f"its cam_K looks like that of a picture of {size} the size; {CAM_K}"
        yield sentence, replace(goal, camera=resized(goal.camera, factor))
    height, width = goal.rgb.shape[:2]
    for quarters in (1, 3):
        camera = replace(goal.camera, width=height, height=width)
        turned = np.ascontiguousarray(np.rot90(goal.rgb, quarters))
        yield f"its image is turned by a quarter; {STORE}", Frame(goal.index, turned, camera)


def _undone(suspect: Suspect, goal: Frame, table: Table, T_world_frames: Float) -> Float:
    """(4, 4) the goal's pose without a suspect mistake.

    Several frames that agree are right. A single one may be wrong in the same way, and the goal's pose counts from it.
    """
    meant = suspect.undo(T_world_frames @ goal.camera.T_world_camera)
    first, *others = table.frames
    if others:
        return invert(T_world_frames) @ meant
    stated = first.camera.T_world_camera
    return stated @ invert(suspect.undo(T_world_frames @ stated)) @ meant


def _median(goal: Frame, table: Table, plans: list[Plan]) -> float:
    """How alike the table is in the goal and in the current frames; -1 where too little is compared."""
    alike = _likeness(goal, table, plans)
    return float(np.median(alike)) if len(alike) >= PATCHES else -1.0


def _likeness(goal: Frame, table: Table, plans: list[Plan]) -> Float:
    whole = np.ones(goal.rgb.shape[:2], bool)
    return likeness(plan(table, goal.camera, goal.rgb, whole), plans)
