"""The goal image against the current frames: does its camera see the table, and is the table where its pose says?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.perception.checks.likeness import PATCHES, Plan, bare_plans, between, likeness, plan
from toolkit.perception.checks.suspects import AXES, FLIPS, STORE, Suspect, rescaled
from toolkit.perception.tabletop.table import Table
from toolkit.types import Finding, Float, Frame

_LEAST_SHARE, _SMALL_SHARE, _FAIR_SHARE = 0.02, 0.1, 0.3
"""Parts of the goal image that show the table: with less nothing can be found, or little, or all may be well."""

_UNLIKE, _LIKE = 0.15, 0.5
"""Correlations of the table's texture: a table elsewhere is below the one, the same table above the other."""

_STRANGE, _FAMILIAR = 0.2, 0.1
"""Parts of the current frames' patches that no other frame has: with colours flipped against depth, and without."""

_DOUBT, _LITTLE = 0.3, 0.5

_UNITS = tuple(
    Suspect(rescaled(factor), f"its pose looks like one in {unit}", "cam_t_w2c is in millimetres")
    for factor, unit in ((1000.0, "metres"), (10.0, "centimetres"))
)


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
    alike = _likeness(goal, goal.camera.T_world_camera, table, plans)
    textured = len(alike) >= PATCHES
    if np.median(alike) > _UNLIKE if textured else share > _FAIR_SHARE:
        return []
    blind = f"the goal image shows {'no' if share < _LEAST_SHARE else 'another'} table, by its pose"
    for suspect in (*AXES, *_UNITS):
        seen = _likeness(goal, _undone(suspect, goal, table, T_world_frames), table, plans)
        if len(seen) >= PATCHES and np.median(seen) > _LIKE:
            return [Finding("refused", f"{blind}, and {suspect.sentence}")]
    if share < _LEAST_SHARE:
        remedy = "is goal/scene_camera.json in the same world, axes and units as current/scene_camera.json?"
        return [Finding("refused", f"{blind}; {remedy}")]
    for how, axes in FLIPS.items():
        flipped = _likeness(replace(goal, rgb=np.flip(goal.rgb, axes)), goal.camera.T_world_camera, table, plans)
        if len(flipped) >= PATCHES and np.median(flipped) > _LIKE:
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


def _likeness(goal: Frame, pose: Float, table: Table, plans: list[Plan]) -> Float:
    try:
        camera = replace(goal.camera, T_world_camera=pose)
    except ToolkitError:
        # No camera can be that far away.
        return np.zeros(0)
    whole = np.ones(goal.rgb.shape[:2], bool)
    return likeness(plan(table, camera, goal.rgb, whole), plans)
