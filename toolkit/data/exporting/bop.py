"""Results of the BOP challenge as CSV, which bop_toolkit scores."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from toolkit.data.bop import load_capture
from toolkit.data.exporting.results import Exporter, Result
from toolkit.errors import ToolkitError
from toolkit.files import write_text
from toolkit.geometry import invert, transform_points
from toolkit.registry import Plugin, PluginConfig
from toolkit.results.poses import GoalObject, matrix
from toolkit.types import Capture, Float, Placed

COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")

_SLACK_M = 0.005
"""Points this far outside its box may still be an object's: noise of depth."""

_MOST = 0.5
"""An instance is the object whose box holds at least this part of its points."""


class BopConfig(PluginConfig):
    """Settings of `Bop`."""

    captures: Path = Field(description="the capture that was estimated, or the folder of captures that was evaluated")
    scene: int | None = Field(
        None, ge=0, description="scene_id of the one capture; where left out, the number that is its name, or its place"
    )


class Bop(Plugin[BopConfig], Exporter):
    """OUT.csv: the pose of every object in its goal image, in the format of the BOP challenge.

    A row has scene_id, im_id (the goal image's), obj_id, score, R (model to camera, row by row), t (millimetres) and
    time (seconds for the whole image; -1 where it is not known), as bop_toolkit reads them (Hodan et al., ECCVW 2020).
    Motions take objects from where they are now, so poses need the truth of the current frames: an instance is the
    object whose true box holds most of its points. The score is the confidence; 1 where there is none.
    """

    stage, name = "export kind", "bop"

    def write(self, results: Sequence[Result], out: Path) -> list[str]:
        if self.config.scene is not None and len(results) > 1:
            raise ToolkitError(f"`scene` is the number of one capture, and there are {len(results)}; leave it out")
        text, notes = io.StringIO(), list[str]()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(COLUMNS)
        for place, result in enumerate(results):
            name = result.folder.name
            folder = self.config.captures if len(results) == 1 else self.config.captures / name
            capture = load_capture(folder)
            if capture.truth is None:
                raise ToolkitError(f"'{folder}' has no truth, from which obj_id and the pose of its models are taken")
            now = {i: Placed(t.model, t.T_world_current) for i, t in capture.truth.items()} | dict(capture.only_current)
            spent = sum(sum(entry.time_ms.values()) for entry in result.poses.objects) / 1e3
            for entry in result.poses.objects:
                instance = result.poses.instance(entry.instance)
                if instance is None or entry.T_goal_current is None:
                    continue
                true = _object_of(result.cloud(instance)[0], now)
                if true is None:
                    notes.append(f"{capture.name}: instance {instance.instance} is no object of the truth: left out")
                    continue
                scene = self._scene(capture, place)
                rows.writerow([scene, capture.goal.index, *_pose(entry, true, capture), repr(spent if spent else -1)])
        out.parent.mkdir(parents=True, exist_ok=True)
        write_text(out, text.getvalue())
        return notes

    def _scene(self, capture: Capture, place: int) -> int:
        if self.config.scene is not None:
            return self.config.scene
        return int(capture.name) if capture.name.isdigit() else place


def _pose(entry: GoalObject, true: Placed, capture: Capture) -> list[str]:
    """obj_id, score, R and t."""
    assert entry.T_goal_current is not None
    T = invert(capture.goal.camera.T_world_camera) @ matrix(entry.T_goal_current) @ true.T_world_model
    score = 1.0 if entry.confidence is None else entry.confidence
    R, t = T[:3, :3].ravel().tolist(), (T[:3, 3] * 1e3).tolist()
    return [str(true.model.object_id), repr(score), " ".join(map(repr, R)), " ".join(map(repr, t))]


def _object_of(points: Float, now: Mapping[int, Placed]) -> Placed | None:
    """The object whose box holds most of (N, 3) world points, and at least half."""
    shares = {instance: _share_inside(points, placed) for instance, placed in now.items()}
    best = max(shares, key=lambda instance: shares[instance], default=None)
    return now[best] if best is not None and shares[best] >= _MOST else None


def _share_inside(points: Float, placed: Placed) -> float:
    own = transform_points(invert(placed.T_world_model), points) - placed.model.center
    return float((np.abs(own) <= placed.model.box_size / 2 + _SLACK_M).all(axis=1).mean())
