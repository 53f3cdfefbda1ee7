"""One scene as a Rerun recording: what the cameras saw, the fused models, where they go, and the truth beside it."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from toolkit.errors import ToolkitError
from toolkit.geometry import transform_points
from toolkit.perception.database import Database
from toolkit.perception.fusion import Clouds
from toolkit.results.metrics import assign_goal_objects
from toolkit.results.rows import Row
from toolkit.results.scoring import score
from toolkit.types import Camera, Capture, Float, Frame, Image, ObjectModel, PoseEstimate

Color = tuple[int, int, int]
"""RGB, 0..255."""

_RIGHT: Color = (46, 204, 113)
_WRONG: Color = (231, 76, 60)
_UNKNOWN: Color = (52, 152, 219)
_TRUTH: Color = (241, 196, 15)

_JPEG_QUALITY = 90
_DEPTH_UNITS_M = 2000.0
"""Depth is kept in steps of 0.5 mm, up to 32 m."""

_POINT_M = 0.0012
_PLANE_M = 0.12
"""Radius of drawn points, and how far before its camera an image hangs."""


def load_rerun() -> Any:
    """The rerun module.

    Raises:
        ToolkitError: it is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise ToolkitError(
            "recordings need rerun-sdk, which is not installed; run: pip install 'rearrange-toolkit[view]'"
        ) from error
    return rerun


def has_rerun() -> bool:
    """Say whether recordings can be written here."""
    return find_spec("rerun") is not None


@contextmanager
def recording(path: Path, name: str, blueprint: Any = None) -> Generator[Any]:
    """A stream whose entries are written to `path`, for as long as the `with` block lasts.

    Args:
        path: the .rrd file; its folder is made.
        name: what the viewer calls the recording.
        blueprint: how the viewer lays it out at first.

    Raises:
        ToolkitError: rerun is not installed, or the file cannot be written.
    """
    rr = load_rerun()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = rr.RecordingStream("toolkit", recording_id=name)
        stream.save(path, default_blueprint=blueprint)
    except (OSError, RuntimeError) as error:
        raise ToolkitError(f"recording '{path}' cannot be written: {error}") from error
    stream.send_recording_name(name)
    try:
        yield stream
    finally:
        stream.disconnect()


def record_scene(
    path: Path, name: str, capture: Capture, database: Database, clouds: Clouds, estimates: Sequence[PoseEstimate]
) -> None:
    """Write one capture and what was estimated for it.

    Under `current/`: `frames/<index>` (pinhole, `rgb`, `depth`), `instances/<instance>` (coloured points) and
    `truth/<object>` (boxes). Under `goal/`: `camera` (pinhole, `rgb`, `objects`), `estimates/<goal object>` (the chosen
    instance's points, moved) and `truth/<object>`. `summary` says in words how every object fared. World coordinates
    in metres.

    Args:
        path: the .rrd file.
        name: what the viewer calls the recording.
        capture: with the goal camera's pose as the estimates mean it.
        database: the current scene's; its frames are recorded.
        clouds: of all of its instances.
        estimates: one per goal object.

    Raises:
        ToolkitError: rerun is not installed, or the file cannot be written.
    """
    rr = load_rerun()
    rows = score(capture, estimates) if capture.truth is not None and capture.goal.true_masks is not None else []
    named = _named(capture, estimates, rows)
    with recording(path, name, _blueprint(rr, [frame.index for frame in database.frames])) as stream:
        for side in ("current", "goal"):
            stream.log(side, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for frame in database.frames:
            _log_frame(stream, rr, f"current/frames/{frame.index:06d}", frame)
        for instance, (points, colors) in clouds.items():
            log_points(stream, rr, f"current/instances/{instance}", points, colors, f"instance {instance}")
        _log_frame(stream, rr, "goal/camera", capture.goal)
        _log_boxes(stream, rr, estimates, named)
        for estimate in estimates:
            _log_estimate(stream, rr, estimate, clouds, _label(estimate, named.get(estimate.goal_object)))
        for instance_id, true in (capture.truth or {}).items():
            log_box(stream, rr, f"current/truth/{instance_id}", true.model, true.T_world_current)
            log_box(stream, rr, f"goal/truth/{instance_id}", true.model, true.T_world_goal)
        words = rr.TextDocument(_summary(name, estimates, named, rows), media_type=rr.MediaType.MARKDOWN)
        stream.log("summary", words, static=True)


def transform(rr: Any, T: Float) -> Any:
    """A (4, 4) pose as Rerun has it."""
    return rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])


def log_camera(stream: Any, rr: Any, entity: str, camera: Camera) -> None:
    """Log a posed pinhole camera. Rerun's pixel (0, 0) is the corner of the top-left pixel, ours its centre."""
    T, K = camera.T_world_camera, camera.K.copy()
    K[:2, 2] += 0.5
    stream.log(entity, transform(rr, T), static=True)
    pinhole = rr.Pinhole(
        image_from_camera=K,
        resolution=[camera.width, camera.height],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=_PLANE_M,
    )
    stream.log(entity, pinhole, static=True)


def log_picture(stream: Any, rr: Any, entity: str, rgb: Image) -> None:
    """Log an (H, W, 3) uint8 image, as JPEG."""
    _, data = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    stream.log(entity, rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg"), static=True)


def log_box(stream: Any, rr: Any, entity: str, model: ObjectModel, T_world_object: Float) -> None:
    """Log a model's box where the object truly is."""
    center = transform_points(T_world_object, model.center)
    stream.log(entity, rr.Transform3D(translation=center, mat3x3=T_world_object[:3, :3]), static=True)
    box = rr.Boxes3D(half_sizes=[model.box_size / 2], colors=[_TRUTH], labels=[model.name], show_labels=False)
    stream.log(entity, box, static=True)


def _log_frame(stream: Any, rr: Any, entity: str, frame: Frame) -> None:
    log_camera(stream, rr, entity, frame.camera)
    log_picture(stream, rr, f"{entity}/rgb", frame.rgb)
    if frame.depth is not None:
        units = np.clip(np.rint(frame.depth * _DEPTH_UNITS_M), 0, 65535).astype(np.uint16)
        data = cv2.imencode(".png", units)[1].tobytes()
        depth = rr.EncodedDepthImage(data, media_type="image/png", meter=_DEPTH_UNITS_M)
        stream.log(f"{entity}/depth", depth, static=True)


def log_points(stream: Any, rr: Any, entity: str, points: Float, colors: Float, label: str) -> None:
    """Log (N, 3) points with their (N, 3) colours, 0..255."""
    shown = np.clip(np.rint(colors), 0, 255).astype(np.uint8)
    cloud = rr.Points3D(points, colors=shown, radii=_POINT_M, labels=[label], show_labels=True)
    stream.log(entity, cloud, static=True)


def _log_boxes(stream: Any, rr: Any, estimates: Sequence[PoseEstimate], named: dict[int, Row]) -> None:
    """The goal objects in the goal image."""
    if not estimates:
        return
    corners = np.array([estimate.segment.bbox_xyxy for estimate in estimates], np.float32)
    rows = [named.get(estimate.goal_object) for estimate in estimates]
    boxes = rr.Boxes2D(
        mins=corners[:, :2],
        sizes=corners[:, 2:] - corners[:, :2] + 1,
        colors=[_color(row) for row in rows],
        labels=[_label(estimate, row) for estimate, row in zip(estimates, rows, strict=True)],
        show_labels=True,
    )
    stream.log("goal/camera/objects", boxes, static=True)


def _log_estimate(stream: Any, rr: Any, estimate: PoseEstimate, clouds: Clouds, label: str) -> None:
    """What was said of a goal object; and its instance's points, where they were taken to be."""
    entity = f"goal/estimates/{estimate.goal_object}"
    alike = 0 if estimate.equivalents is None else len(estimate.equivalents)
    said = rr.AnyValues(
        status=estimate.status,
        confidence=estimate.confidence,
        ambiguity=estimate.ambiguity,
        equivalents=alike,
        reason=_why_not(estimate) or None,
    )
    stream.log(entity, said, static=True)
    if estimate.T_goal_current is not None and estimate.instance in clouds:
        points, colors = clouds[estimate.instance]
        log_points(stream, rr, entity, estimate.move(points), colors, label)


def _named(capture: Capture, estimates: Sequence[PoseEstimate], rows: Sequence[Row]) -> dict[int, Row]:
    """The row of every goal object that answers for a true one."""
    if capture.goal.true_masks is None:
        return {}
    answers = assign_goal_objects([e.segment for e in estimates], capture.goal.true_masks)
    return {estimates[answers[row.object]].goal_object: row for row in rows if row.object in answers}


def _color(row: Row | None) -> Color:
    if row is None:
        return _UNKNOWN
    return _RIGHT if row.success_sym else _WRONG


def _label(estimate: PoseEstimate, row: Row | None) -> str:
    """A goal object in a line, e.g. `2 mug: 0.93, hidden`."""
    name = f"{estimate.goal_object} {row.object_name}" if row else str(estimate.goal_object)
    said = [] if estimate.confidence is None else [f"{estimate.confidence:.2f}"]
    said += [estimate.ambiguity] if estimate.ambiguity not in (None, "none") else []
    said += [estimate.status] if estimate.failure else []
    return f"{name}: {', '.join(said)}" if said else name


def _why_not(estimate: PoseEstimate) -> str:
    return "" if estimate.failure is None else f"{estimate.failure.stage}: {estimate.failure.reason}"


def _summary(name: str, estimates: Sequence[PoseEstimate], named: dict[int, Row], rows: Sequence[Row]) -> str:
    """How every object fared, as Markdown."""
    lines = [
        f"# {name}",
        "",
        *([f"{sum(row.success_sym for row in rows)} of {len(rows)} objects right (5 deg, 2 cm)", ""] if rows else []),
        "| object | name | status | off | confidence | ambiguity | why not |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for e in estimates:
        row = named.get(e.goal_object)
        sure = "" if e.confidence is None else f"{e.confidence:.2f}"
        ambiguity = e.ambiguity or ""
        if e.equivalents is not None and len(e.equivalents) > 1:
            ambiguity += f" ({len(e.equivalents)} motions)"
        known = row.object_name if row else ""
        lines.append(f"| {e.goal_object} | {known} | {e.status} | {off(row)} | {sure} | {ambiguity} | {_why_not(e)} |")
    missed = [row for row in rows if row.status == "missed"]
    lines += [f"| | {row.object_name} | missed | | | | {row.stage}: {row.reason} |" for row in missed]
    return "\n".join(lines)


def off(row: Row | None) -> str:
    """How far a row's motion is from the truth, symmetry-aware; empty where there is none."""
    if row is None or row.rotation_error_deg_sym is None or row.translation_error_cm_sym is None:
        return ""
    return f"{row.rotation_error_deg_sym:.1f} deg, {row.translation_error_cm_sym:.1f} cm"


def _blueprint(rr: Any, frames: Sequence[int]) -> Any:
    """Models and goal side by side, the goal image and the words below."""
    bp = rr.blueprint
    depths = [f"- /current/frames/{index:06d}/depth" for index in frames]
    current = bp.Tabs(
        bp.Spatial3DView(origin="/current", name="current: models", contents=["+ /current/**", *depths]),
        bp.Spatial3DView(origin="/current", name="current: as measured"),
        *(bp.Spatial2DView(origin=f"/current/frames/{i:06d}", name=f"frame {i}") for i in frames),
    )
    goal = bp.Spatial3DView(origin="/goal", name="goal: estimates and truth")
    below = bp.Horizontal(
        bp.Spatial2DView(origin="/goal/camera", name="goal image"), bp.TextDocumentView(origin="/summary")
    )
    return bp.Blueprint(bp.Vertical(bp.Horizontal(current, goal), below, row_shares=[3, 2]), collapse_panels=True)
