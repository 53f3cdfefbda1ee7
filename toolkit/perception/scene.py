"""The current scene as a pipeline knows it, asked for the motions towards one goal image after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from toolkit.perception.database import Database
from toolkit.perception.fusion import Models, RefineTask, Start
from toolkit.perception.lifting import merge
from toolkit.perception.parts import Parts
from toolkit.perception.ranking import rank
from toolkit.perception.search import Accepted, References, search_candidates
from toolkit.types import Failure, Frame, PoseEstimate, Segment


class Scene:
    """A database and what is made of it on the way: features of its regions and fused models, kept for further goals.

    Args:
        parts: the pipeline's.
        database: of the current scene; it may be empty.
    """

    def __init__(self, parts: Parts, database: Database) -> None:
        self.database = database
        self.models = Models(database)
        self._parts = parts
        self._references = References(database, parts.stages.matcher, parts.settings.crop_margin)

    def estimate(self, goal: Frame) -> list[PoseEstimate]:
        """Pose estimation (Sec. Method A): one estimate for every object segmented in the goal image.

        The time that all objects share, the database's if that has just been built, is spread evenly over them.

        Raises:
            ToolkitError: a stage refuses its input.
        """
        parts, database = self._parts, self.database
        with parts.meter.stage("registration"):
            goal = parts.stages.registration.locate(goal, database.frames)
        with parts.meter.stage("segmenter"):
            segments = parts.stages.goal_segmenter.segment(goal, database.frames)
        if not segments:
            return []
        rankings = rank(parts, database, goal, segments, self.models) if len(database) else []
        shared_ms, shared_cached = parts.meter.take()
        shared_ms = {stage: time / len(segments) for stage, time in shared_ms.items()}
        estimates: list[PoseEstimate] = []
        for number, segment in enumerate(segments):
            if rankings:
                estimate = self._from_matches(goal, number, segment, rankings[number])
                estimate = self._refine(estimate, goal, segments)
            else:
                failure = Failure("segmenter", "no object region was found in the current frames")
                estimate = PoseEstimate(number, segment, None, None, failure)
            own_ms, own_cached = parts.meter.take()
            time_ms = {s: shared_ms.get(s, 0.0) + own_ms.get(s, 0.0) for s in {**shared_ms, **own_ms}}
            estimates.append(replace(estimate, time_ms=time_ms, cached=shared_cached or own_cached))
        return estimates

    def _from_matches(self, goal: Frame, number: int, segment: Segment, ranking: NDArray[np.int64]) -> PoseEstimate:
        """The best supported motion of the instances that were accepted."""
        instances = self.database.instances
        found = search_candidates(self._parts, self._references, goal, segment, ranking)
        if not found.accepted:
            wanted = self._parts.settings.min_matches
            failure = Failure("matcher", f"no candidate reached {wanted} lifted matches (best: {found.most_matches})")
            instance = None if found.first is None else int(instances[found.first])
            return PoseEstimate(number, segment, instance, None, failure, matcher_calls=found.matcher_calls)
        by_instance: dict[int, list[Accepted]] = {}
        for candidate in found.accepted:
            by_instance.setdefault(int(instances[candidate.row]), []).append(candidate)
        solved = [self._solve(accepted, goal, number, segment, i) for i, accepted in by_instance.items()]
        return replace(max(solved, key=_support), matcher_calls=found.matcher_calls)

    def _solve(
        self, accepted: list[Accepted], goal: Frame, number: int, segment: Segment, instance: int
    ) -> PoseEstimate:
        problem = merge([a.correspondences for a in accepted])
        candidates = tuple((a.row, len(a.correspondences)) for a in accepted)
        with self._parts.meter.stage("pnp"):
            solution = self._parts.stages.pnp.solve(problem, self._parts.seed)
        if isinstance(solution, Failure):
            return PoseEstimate(
                number, segment, instance, None, solution, correspondences=problem, candidates=candidates
            )
        return PoseEstimate(
            number,
            segment,
            instance,
            goal.camera.T_world_camera @ solution.T_camera_world,
            correspondences=problem,
            inliers=solution.inliers,
            covariance=solution.covariance,
            candidates=candidates,
        )

    def _refine(self, estimate: PoseEstimate, goal: Frame, segments: Sequence[Segment]) -> PoseEstimate:
        """Let the refiner improve the motion, or find one where the matches gave none."""
        if estimate.instance is None:
            return estimate
        number, starts = estimate.goal_object, starts_of(estimate)
        task = RefineTask.of(goal, segments, number, estimate.instance, self.models, starts)
        with self._parts.meter.stage("refiner"):
            refined = self._parts.stages.refiner.refine(task)
        if refined is None:
            return estimate
        if isinstance(refined, Failure):
            return replace(estimate, T_goal_current=None, failure=refined)
        return replace(
            estimate,
            T_goal_current=refined.T_goal_current,
            failure=None,
            confidence=refined.confidence,
            equivalents=refined.equivalents,
            ambiguity=refined.ambiguity,
            covariance=refined.covariance,
        )


def starts_of(estimate: PoseEstimate) -> tuple[Start, ...]:
    """What PnP found, as a refiner may start from it."""
    if estimate.T_goal_current is None or estimate.correspondences is None:
        return ()
    return (Start(estimate.T_goal_current, estimate.covariance, estimate.correspondences.points.mean(axis=0)),)


def _support(estimate: PoseEstimate) -> int:
    """Inliers behind an estimate; a failure has fewer than any solution."""
    return -1 if estimate.inliers is None else int(estimate.inliers.sum())
