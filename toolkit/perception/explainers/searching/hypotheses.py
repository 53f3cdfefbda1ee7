"""Where an instance may stand in the goal image: where it stands now, and the best places all over the table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from toolkit.geometry import invert, make_transform, project, rotation_z, transform_points
from toolkit.perception.explainers.searching.evidence import MOST_COST, Evidence
from toolkit.perception.explainers.searching.renderings import Surface
from toolkit.perception.explainers.searching.scores import Sample, Scorer
from toolkit.perception.fusion import FusedModel
from toolkit.perception.tabletop.table import Table
from toolkit.types import Camera, Float

_POINTS, _FINE_POINTS = 192, 512
_FOREGROUND = 0.1
"""Places around which less of the image than this is foreground are not tried."""

_DISTINCT_M = 0.04
_STEP, _LEAST_STEP_M, _MOST_YAWS = 0.7, 0.008, 72
"""Places, and where turns take an object's ends, are no further apart than this part of its width, or they would step
over small and thin things."""

_COARSE_PX = 5.0
"""An object whose radius is less than this in the coarse image is looked for in the fine one."""

_LEVELS = ((0.012, 0.13), (0.005, 0.05), (0.002, 0.02))
"""Steps in metres and radians by which a hypothesis is moved while it gains."""

_MOVES = 3
_STILL_M, _STILL_RAD = 0.004, 0.03
"""A hypothesis this close to where the object stands now is that it was not moved."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A planar motion: a turn about the vertical through the object's centre, radians, and a (2,) shift, metres."""

    turn: float
    shift: Float

    @property
    def moved(self) -> bool:
        """Whether the object would stand elsewhere than now."""
        return abs(_wrapped(self.turn)) > _STILL_RAD or float(np.hypot(*self.shift)) > _STILL_M


@dataclass(frozen=True, eq=False)
class Searcher:
    """What the hypotheses of one goal image share.

    Attributes:
        table: the table.
        camera: the goal image's.
        coarse: the image, for places all over the table.
        fine: the image, for the last millimetres.
        step: metres between the places tried, at most.
        yaws: turns tried at each, at least.
        kept: hypotheses kept, besides that it was not moved.
    """

    table: Table
    camera: Camera
    coarse: Evidence
    fine: Evidence
    step: float
    yaws: int
    kept: int

    @property
    def T_camera_table(self) -> Float:
        """(4, 4)."""
        return invert(self.camera.T_world_camera) @ self.table.T_world_table

    def search(self, model: FusedModel, surface: Surface) -> list[Hypothesis]:
        """Hypotheses of an instance with this surface, that it was not moved first; the others by falling score."""
        center = self._center(model)
        still = Hypothesis(0.0, np.zeros(2))
        radius = _radius(model)
        image = self._image(radius)
        width, length = self._sides(model)
        places = self._places(center, radius, min(self.step, max(_STEP * width, _LEAST_STEP_M)), image)
        found = [still]
        if len(places):
            yaws = int(np.clip(np.pi * length / (_STEP * width), self.yaws, _MOST_YAWS))
            turns = np.arange(yaws) * 2 * np.pi / yaws
            yaw, place = np.repeat(turns, len(places)), np.tile(places, (yaws, 1))
            scores = Scorer(image, self.T_camera_table).score(self._sample(model, surface, _POINTS), yaw, place)
            by_yaw = scores.reshape(yaws, len(places))
            found += [
                Hypothesis(float(turns[by_yaw[:, i].argmax()]), places[i, :2] - center[:2])
                for i in self._peaks(places[:, :2], by_yaw.max(axis=0))
            ]
        return [still, *self._polished(self._sample(model, surface, _FINE_POINTS), center, found)]

    def motion(self, model: FusedModel, hypothesis: Hypothesis) -> Float:
        """(4, 4) T_goal_current of a hypothesis, in world coordinates."""
        center = self._center(model)
        R = rotation_z(hypothesis.turn)[:3, :3]
        planar = make_transform(R, center + np.append(hypothesis.shift, 0.0) - R @ center)
        T = self.table.T_world_table
        return T @ planar @ invert(T)

    def _center(self, model: FusedModel) -> Float:
        """(3,) the model's centre in the table's frame."""
        return transform_points(invert(self.table.T_world_table), model.center)

    def _image(self, radius: float) -> Evidence:
        distance = float(np.linalg.norm(self.T_camera_table[:3, 3]))
        return self.coarse if radius * self.coarse.K[0, 0] / distance > _COARSE_PX else self.fine

    def _sides(self, model: FusedModel) -> tuple[float, float]:
        """The shorter and the longer side of the rectangle around a model seen from above, metres."""
        plan = model.points @ self.table.T_world_table[:3, :2]
        shorter, longer = sorted(cv2.minAreaRect(plan.astype(np.float32))[1])
        return max(shorter, 1e-3), max(longer, 1e-3)

    def _places(self, center: Float, radius: float, step: float, image: Evidence) -> Float:
        """(N, 3) places of the centre on the table around which the goal image shows something."""
        low, high = self.table.outline.min(axis=0), self.table.outline.max(axis=0)
        x, y = (np.arange(a, b, step) for a, b in zip(low, high, strict=True))
        plan = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        plan = plan[self.table.holds(plan)]
        places = np.column_stack([plan, np.full(len(plan), center[2])])
        xy, depth = project(image.K, self.T_camera_table, places)
        pixels = np.rint(np.nan_to_num(xy, nan=-1.0)).astype(np.int64)
        height, width = image.background.shape
        inside = (pixels >= 0).all(axis=1) & (pixels < [width, height]).all(axis=1)
        places, depth, pixels = places[inside], depth[inside], pixels[inside]
        if not len(places):
            return places
        side = 2 * max(1, round(radius * image.K[0, 0] / float(np.median(depth)))) + 1
        foreground = (image.background > MOST_COST / 3).astype(np.float32)
        around = cv2.blur(foreground, (side, side), borderType=cv2.BORDER_CONSTANT)
        return places[around[pixels[:, 1], pixels[:, 0]] > _FOREGROUND]

    def _sample(self, model: FusedModel, surface: Surface, count: int) -> Sample:
        """The first points of a surface, which are in no order."""
        R, points = self.table.T_world_table[:3, :3], surface.points[:count]
        padding = count - len(points)
        arrays = (
            (points - model.center) @ R,
            surface.normals[:count] @ R,
            surface.colours[:count],
            np.ones(len(points)),
        )
        return Sample(*(np.pad(a, ((0, padding), *[(0, 0)] * (a.ndim - 1))).astype(np.float32) for a in arrays))

    def _peaks(self, plan: Float, scores: Float) -> list[int]:
        """Places by falling score, none near a better one: a small thing fits well at many places beside each other."""
        kept: list[int] = []
        for i in np.argsort(-scores, kind="stable").tolist():
            if all(np.hypot(*(plan[i] - plan[k])) >= _DISTINCT_M for k in kept):
                kept.append(i)
            if len(kept) == self.kept:
                break
        return kept

    def _polished(self, sample: Sample, center: Float, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
        """Each moved step by step to where its score is greatest, all of them at once."""
        scorer, count = Scorer(self.fine, self.T_camera_table), len(hypotheses)
        turns, shifts = np.array([h.turn for h in hypotheses]), np.array([h.shift for h in hypotheses])
        steps = np.stack(np.meshgrid(*[(0, -1, 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        for metres, radians in _LEVELS:
            for _ in range(_MOVES):
                yaw = turns[:, None] + steps[:, 0] * radians
                shift = shifts[:, None] + steps[:, 1:] * metres
                place = np.concatenate([center[:2] + shift, np.full((*yaw.shape, 1), center[2])], axis=2)
                scores = scorer.score(sample, yaw.ravel(), place.reshape(-1, 3)).reshape(yaw.shape)
                best = scores.argmax(axis=1)
                turns, shifts = yaw[np.arange(count), best], shift[np.arange(count), best]
                if not best.any():
                    break
        return [Hypothesis(float(turn), shift) for turn, shift in zip(turns, shifts, strict=True)]


def _radius(model: FusedModel) -> float:
    """Metres: how far an object reaches to the side, about."""
    return float(np.median(np.linalg.norm(model.points - model.center, axis=1)))


def _wrapped(angle: Any) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
