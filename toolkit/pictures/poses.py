"""Pose estimates of one capture as poses.json, with goal masks, fused models and pictures beside it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.data.clouds import write_cloud
from toolkit.files import write_json
from toolkit.geometry import invert, project
from toolkit.perception.database import Database
from toolkit.perception.extents import measure_extent
from toolkit.perception.fusion import Clouds
from toolkit.pictures.cases import write_case
from toolkit.pictures.drawing import Color, correspondences, overlay, with_legend, write_png, zoomed
from toolkit.results.answer import SURE, in_words
from toolkit.results.metrics import assign_goal_objects
from toolkit.results.poses import POSES, SCHEMA, Found, GoalObject, Instance, Poses
from toolkit.results.rows import Row
from toolkit.types import Capture, Finding, Float, Mask, PoseEstimate

_MASKS, _MODELS = "masks", "models"


def write_poses(
    out: Path,
    capture: Capture,
    database: Database,
    clouds: Clouds,
    estimates: Sequence[PoseEstimate],
    findings: Sequence[Finding] = (),
) -> Path:
    """Write OUT/poses.json, the goal masks and fused models it names, and pictures. Returns the path of poses.json.

    Args:
        out: the folder.
        capture: that was estimated.
        database: of its current scene, its instances as the goal shows them.
        clouds: of all of its instances.
        estimates: one per goal object.
        findings: what was found wrong with the capture.
    """
    for folder in (_MASKS, _MODELS):
        (out / folder).mkdir(parents=True, exist_ok=True)
    poses = Poses(
        schema=SCHEMA,
        capture=capture.name,
        objects=[_write_object(out, estimate) for estimate in estimates],
        instances=[_write_instance(out, number, cloud, database.T_world_level) for number, cloud in clouds.items()],
        not_in_goal=missing_instances(database, estimates),
        not_in_current=[estimate.goal_object for estimate in estimates if estimate.instance is None],
        findings=[Found(severity=f.severity, sentence=f.sentence, cap=f.cap, frames=list(f.frames)) for f in findings],
    )
    path = out / POSES
    write_json(path, poses.model_dump(by_alias=True, mode="json"))
    write_pictures(out, capture, database, estimates, findings)
    return path


def _write_object(out: Path, estimate: PoseEstimate) -> GoalObject:
    mask = f"{_MASKS}/{estimate.goal_object:06d}.png"
    write_png(out / mask, estimate.segment.mask.astype(np.uint8) * 255)
    failure = estimate.failure
    return GoalObject(
        goal_object=estimate.goal_object,
        bbox_xyxy=list(estimate.segment.bbox_xyxy),
        mask=mask,
        instance=estimate.instance,
        status=estimate.status,
        T_goal_current=_listed(estimate.T_goal_current),
        confidence=estimate.confidence,
        ambiguity=estimate.ambiguity,
        covariance=_listed(estimate.covariance),
        equivalents=_listed(estimate.equivalents),
        stage=failure.stage if failure else None,
        reason=failure.reason if failure else None,
        time_ms={stage: round(ms, 3) for stage, ms in estimate.time_ms.items()},
    )


def _write_instance(out: Path, number: int, cloud: tuple[Float, Float], T_world_level: Float) -> Instance:
    model = f"{_MODELS}/{number:06d}.ply"
    points, colors = cloud
    write_cloud(out / model, points, colors)
    extent = measure_extent(points, T_world_level)
    return Instance(
        instance=number,
        center=extent.T_world_box[:3, 3].tolist(),
        T_world_box=extent.T_world_box.tolist(),
        size=extent.size.tolist(),
        footprint=extent.footprint.tolist(),
        model=model,
    )


def _listed(array: Float | None) -> Any:
    return None if array is None else array.tolist()


_SURE, _DOUBTFUL, _WITHHELD, _UNKNOWN = (40, 200, 90), (245, 190, 40), (240, 80, 60), (200, 140, 235)
_COLORS: dict[str, Color] = {
    "sure": _SURE,
    "found": _SURE,
    "doubtful": _DOUBTFUL,
    "withheld": _WITHHELD,
    "failed": _WITHHELD,
    "unknown": _UNKNOWN,
}
_PLAIN: Color = (225, 225, 225)
LEGEND: dict[str, Color] = {
    f"sure (over {SURE:.0%})": _SURE,
    "doubtful: look at it": _DOUBTFUL,
    "withheld: no motion": _WITHHELD,
    "unknown: not in the current scene": _UNKNOWN,
}
"""What the colours of an overlay mean."""


def write_pictures(
    out: Path,
    capture: Capture,
    database: Database,
    estimates: Sequence[PoseEstimate],
    findings: Sequence[Finding] = (),
) -> None:
    """Write OUT/overlay.png, and OUT/matches_<object>.png for every object that has correspondences."""
    write_png(out / "overlay.png", overlay_picture(capture, database, estimates, findings))
    for estimate in estimates:
        picture = matches_picture(capture, database, estimate)
        if picture is not None:
            write_png(out / f"matches_{estimate.goal_object:06d}.png", picture)


def overlay_picture(
    capture: Capture, database: Database, estimates: Sequence[PoseEstimate], findings: Sequence[Finding] = ()
) -> np.ndarray:
    """The goal image with every goal object: number, instance and confidence, coloured by how sure that is.

    An object with a motion is outlined where that puts its instance, one without by its mask. Beneath stand what the
    colours mean, the instances that the goal does not show, and what was found wrong with the capture.

    Returns:
        (H', W, 3) uint8, the goal image on top.
    """
    picture = overlay(capture.goal, _outlines(database, estimates), _masks(estimates))
    missing = missing_instances(database, estimates)
    absent = [f"not seen in the goal: {', '.join(f'#{i}' for i in missing)}"] if missing else []
    said = [(f"{finding.severity}: {finding.sentence}", _DOUBTFUL) for finding in findings]
    return with_legend(picture, [*LEGEND.items(), *((line, _PLAIN) for line in absent), *said])


def _outlines(database: Database, estimates: Sequence[PoseEstimate]) -> list[tuple[str, Float, Color]]:
    """Label, (N, 3) world points moved to the goal, and colour of every object with a motion."""
    outlines: list[tuple[str, Float, Color]] = []
    for estimate in estimates:
        if estimate.T_goal_current is not None and estimate.instance is not None:
            points = np.concatenate([database.regions[row].points for row in database.instance(estimate.instance)])
            outlines.append((_label(estimate), estimate.move(points), _color(estimate)))
    return outlines


def _masks(estimates: Sequence[PoseEstimate]) -> list[tuple[str, Mask, Color]]:
    """Label, (H, W) bool and colour of every object without a motion."""
    return [(_label(e), e.segment.mask, _color(e)) for e in estimates if e.T_goal_current is None]


def missing_instances(database: Database, estimates: Sequence[PoseEstimate]) -> list[int]:
    """Instances of the current scene that no goal object is taken for."""
    return sorted(set(database.instances.tolist()) - {e.instance for e in estimates})


def _label(estimate: PoseEstimate) -> str:
    """Number of the goal object, instance, and confidence or why there is none."""
    if estimate.instance is None:
        return f"{estimate.goal_object}: unknown"
    said = "withheld" if estimate.T_goal_current is None else _percent(estimate.confidence)
    return f"{estimate.goal_object}: #{estimate.instance} {said}"


def _percent(confidence: float | None) -> str:
    return "" if confidence is None else f"{100 * confidence:.0f} %"


def _color(estimate: PoseEstimate) -> Color:
    return _COLORS[in_words(estimate)]


def matches_picture(capture: Capture, database: Database, estimate: PoseEstimate) -> np.ndarray | None:
    """The correspondences of one object, goal beside current frames, each zoomed in on them (uint8 RGB).

    None when there are none.
    """
    problem = estimate.correspondences
    if problem is None or not len(problem):
        return None
    rows = np.repeat([row for row, _ in estimate.candidates], [count for _, count in estimate.candidates])
    frame_of = np.array([database.regions[row].frame_index for row in rows])
    frames = {frame.index: frame for frame in database.frames}
    xy = np.zeros((len(problem), 2))
    images: dict[int, np.ndarray] = {}
    for index in map(int, np.unique(frame_of)):
        camera = frames[index].camera
        seen = frame_of == index
        pixels = project(camera.K, invert(camera.T_world_camera), problem.points[seen])[0]
        images[index], xy[seen] = zoomed(frames[index].rgb, pixels)
    goal, goal_xy = zoomed(capture.goal.rgb, problem.pixels)
    return correspondences(goal, goal_xy, images, frame_of, xy, estimate.inliers)


def write_object(run: Path, capture: Capture, database: Database, estimates: Sequence[PoseEstimate], row: Row) -> None:
    """Write one object of a scored capture as a picture of a run's report.

    The picture shows its true place, the place estimated, and the correspondences used.
    """
    answers = assign_goal_objects([e.segment for e in estimates], capture.goal.true_masks or {})
    estimate = estimates[answers[row.object]] if row.object in answers else None
    shown = [] if estimate is None else [estimate]
    true_masks = capture.goal.true_masks or {}
    places = [("", true_masks[row.object], _PLAIN)] if row.object in true_masks else []
    picture = overlay(capture.goal, _outlines(database, shown), _masks(shown), places)
    picture = with_legend(picture, [("true place", _PLAIN), *LEGEND.items()])
    matches = None if estimate is None else matches_picture(capture, database, estimate)
    if matches is not None:
        picture = np.hstack([picture[: len(matches)], matches])
    if row.rotation_error_deg_sym is None:
        outcome = f"{row.status}, {', '.join(filter(None, (row.stage, row.reason)))}"
    else:
        outcome = f"{row.rotation_error_deg_sym:.1f} deg, {row.translation_error_cm_sym:.1f} cm off"
    caption = f"Scene {row.scene_id}, {row.object_name}: {outcome} ({row.cell})"
    write_case(run, f"{row.scene_id:06d}_{row.object:06d}", picture, caption)
