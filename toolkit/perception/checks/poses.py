"""The current frames against each other: poses, units, axes, cam_K, and whether depth lies on colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from toolkit.perception.checks.agreement import Agreement, agreement
from toolkit.perception.checks.sighting import Sighting, sight
from toolkit.perception.checks.suspects import AXES, CAM_K, FLIPS, SIZES, STORE, length, resized, scales
from toolkit.perception.tabletop.plane import pixel_rays
from toolkit.types import Finding, Float, Frame

_LEAST_OVERLAP = 0.3
_ODD, _ODD_AGAINST = 0.4, 2.5
"""A frame is the odd one out if it is contradicted this much, and this many times as much as the others."""

_DOUBT = 0.3


def check_poses(sightings: Sequence[Sighting]) -> list[Finding]:
    """Compare the frames that see a table; with fewer than two there is nothing to compare."""
    return [replace(finding, shown="cameras") for finding in _compared(sightings)] if len(sightings) > 1 else []


def _compared(sightings: Sequence[Sighting]) -> list[Finding]:
    poses = [sighting.frame.camera.T_world_camera for sighting in sightings]
    stated = agreement(sightings, poses)
    if stated.sound and stated.overlap > _LEAST_OVERLAP:
        return _odd_ones(sightings, poses, stated)
    height = float(np.median([sighting.plane.camera_height for sighting in sightings]))
    places = np.array([T[:3, 3] for T in poses])
    baseline = float(np.linalg.norm(places[:, None] - places[None], axis=2).max())
    for suspect in (*AXES, *scales(height, baseline)):
        if _explains(agreement(sightings, [suspect.undo(T) for T in poses]), stated):
            return [Finding("refused", f"the current frames contradict each other, and {suspect.sentence}")]
    for how, axes in FLIPS.items():
        if _explain([_flipped(s.frame, axes) for s in sightings], poses, stated):
            return [Finding("refused", f"the current frames contradict each other, and their depth is {how}; {STORE}")]
    if _explain([_along_axis(s.frame) for s in sightings], poses, stated):
        sentence = "the current frames contradict each other, and their depth looks like distances from the camera"
        return [Finding("refused", f"{sentence}; give depth along the camera's axis, z")]
    for factor, size in SIZES.items():
        if _explain([replace(s.frame, camera=resized(s.frame.camera, factor)) for s in sightings], poses, stated):
            sentence = (
                f"the current frames contradict each other, and cam_K looks like that of pictures of {size} the size"
            )
            return [Finding("refused", f"{sentence}; {CAM_K}")]
    if stated.sound:
        sentence = f"the current frames share only {stated.overlap:.0%} of the table they see"
        return [Finding("said", f"{sentence}; are their poses right?")]
    if baseline < height / 1000:
        sentence = f"the current frames differ, but their cameras are at one place, within {length(baseline)}"
        return [Finding("refused", f"{sentence}; every image needs the pose of its own camera")]
    sentence = f"the current frames contradict each other: {', and '.join(stated.faults)}"
    causes = (
        "are the poses those of these images, cam_K that of their size, and depth in one unit and aligned to colour?"
    )
    return [Finding("doubtful", f"{sentence}; {causes}", _DOUBT)]


def _explains(supposed: Agreement, stated: Agreement) -> bool:
    return supposed.sound and supposed.overlap > max(_LEAST_OVERLAP, stated.overlap / 2)


def _explain(supposed: Sequence[Frame], poses: Sequence[Float], stated: Agreement) -> bool:
    """Whether other frames agree, each of which shows a table."""
    seen = [sighting for sighting in map(sight, supposed) if sighting is not None]
    return len(seen) == len(supposed) and _explains(agreement(seen, poses), stated)


def _odd_ones(sightings: Sequence[Sighting], poses: Sequence[Float], stated: Agreement) -> list[Finding]:
    """Frames that alone contradict the others are left out, if those then agree."""
    usual = float(np.median(stated.contradicted))
    odd: list[int] = np.flatnonzero(stated.contradicted > max(_ODD, _ODD_AGAINST * usual)).tolist()
    rest = [i for i in range(len(sightings)) if i not in odd]
    if not odd or len(rest) < 2:
        return []
    if not agreement([sightings[i] for i in rest], [poses[i] for i in rest]).sound:
        return []
    frames = tuple(sightings[i].frame.index for i in odd)
    named = f"frame{'s' if len(frames) > 1 else ''} {', '.join(map(str, frames))}"
    sentence = f"current {named} contradict{'' if len(frames) > 1 else 's'} all others and is not used"
    return [Finding("left out", f"{sentence}; is the pose another image's?", frames=frames)]


def _along_axis(frame: Frame) -> Frame:
    """The frame whose depth was given along every pixel's ray."""
    assert frame.depth is not None
    stretch = np.linalg.norm(pixel_rays(frame), axis=-1)
    return replace(frame, depth=(frame.depth / stretch).astype(np.float32))


def _flipped(frame: Frame, axes: tuple[int, ...]) -> Frame:
    assert frame.depth is not None
    return replace(frame, depth=np.ascontiguousarray(np.flip(frame.depth, axes)))
