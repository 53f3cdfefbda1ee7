"""The current scene as a pipeline knows it, asked for the motions towards one goal image after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from toolkit.geometry import invert
from toolkit.perception.database import Database
from toolkit.perception.explanation import ExplainTask, Placement
from toolkit.perception.fusion import Clouds, Models, RefineTask, Start, clouds
from toolkit.perception.lifting import merge
from toolkit.perception.parts import Parts
from toolkit.perception.ranking import rank
from toolkit.perception.search import Accepted, References, search_candidates
from toolkit.types import Failure, Frame, PoseEstimate, Segment

Groups = tuple[tuple[int, ...], ...]
"""Instances that are one object, group by group."""


class Scene:
    """A database and what is made of it on the way: features of its regions and fused models, kept for further goals.

    Stages and models know the table's own frame only; goals come from the user's world and motions go back to it.

    Attributes:
        database: its instances as the last goal joined them.
        models: of those instances.

    Args:
        parts: the pipeline's.
        database: of the current scene; it may be empty.
    """

    def __init__(self, parts: Parts, database: Database) -> None:
        self._parts = parts
        self._references = References(database.level, parts.stages.matcher, parts.settings.crop_margin)
        self._joined: dict[Groups, tuple[Database, Models]] = {(): (database, Models(database.level))}
        self._join(())

    def estimate(self, goal: Frame) -> list[PoseEstimate]:
        """Pose estimation (Sec. Method A): one estimate for every object segmented in the goal image.

        The time that all objects share, the database's if that has just been built, is spread evenly over them.

        Raises:
            ToolkitError: a stage refuses its input.
        """
        T_world_level = self.database.T_world_level
        estimates = self._estimate(goal.moved(invert(T_world_level)))
        return [estimate.in_world(T_world_level) for estimate in estimates]

    def clouds(self) -> Clouds:
        """What was seen of every instance, as the last goal joined them."""
        return clouds(self.database, self.models)

    def _join(self, groups: Groups) -> None:
        """Take the instances of each group for one object, and no others: what the last goal joined comes apart."""
        if groups not in self._joined:
            built, models = self._joined[()]
            database = built.joined(groups)
            self._joined[groups] = database, models.joined(database.level, groups)
        self.database, self.models = self._joined[groups]
        self._references.database = self.database.level

    def _estimate(self, goal: Frame) -> list[PoseEstimate]:
        """The estimates in the table's own frame, in which the goal's camera is given."""
        self._join(())
        parts, database = self._parts, self.database.level
        with parts.meter.stage("registration"):
            goal = parts.stages.registration.locate(goal, database.frames)
        with parts.meter.stage("segmenter"):
            segments = parts.stages.goal_segmenter.segment(goal, database.frames)
        with parts.meter.stage("explainer"):
            explanation = parts.stages.explainer.explain(ExplainTask(goal, tuple(segments), self.models))
        if explanation is not None:
            self._join(explanation.joined)
            database = self.database.level
            segments = [*(p.segment for p in explanation.placements), *explanation.unknown]
        if not segments:
            return []
        placements = () if explanation is None else explanation.placements
        # What an explanation leaves over is none of the database's instances.
        wanted, given = segments, None
        if explanation is not None:
            wanted, given = segments[: len(placements)], [p.instance for p in placements]
        rankings = rank(parts, database, goal, wanted, self.models, given) if len(database) and wanted else []
        shared_ms, shared_cached = parts.meter.take()
        shared_ms = {stage: time / len(segments) for stage, time in shared_ms.items()}
        estimates: list[PoseEstimate] = []
        for number, segment in enumerate(segments):
            if number < len(rankings):
                estimate = self._from_matches(goal, number, segment, rankings[number])
                placement = placements[number] if placements else None
                estimate = self._refine(estimate, goal, segments, placement)
            else:
                estimate = PoseEstimate(number, segment, None, None, self._unknown())
            own_ms, own_cached = parts.meter.take()
            time_ms = {s: shared_ms.get(s, 0.0) + own_ms.get(s, 0.0) for s in {**shared_ms, **own_ms}}
            estimates.append(replace(estimate, time_ms=time_ms, cached=shared_cached or own_cached))
        return estimates

    def _unknown(self) -> Failure:
        """Why a goal object that is not looked for has no motion."""
        if not len(self.database):
            return Failure("segmenter", "no object region was found in the current frames")
        causes = "it is new, hidden in all frames, or bare table"
        return Failure("explainer", f"no object of the current scene explains it: {causes}")

    def _from_matches(self, goal: Frame, number: int, segment: Segment, ranking: NDArray[np.int64]) -> PoseEstimate:
        """The best supported motion of the instances that were accepted."""
        instances = self.database.instances
        found = search_candidates(self._parts, self._references, goal, segment, ranking)
        if not found.accepted:
            wanted = self._parts.settings.min_matches
            failure = Failure(
                "matcher", f"too few lifted matches (best candidate: {found.most_matches}, {wanted} needed)"
            )
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

    def _refine(
        self, estimate: PoseEstimate, goal: Frame, segments: Sequence[Segment], placement: Placement | None
    ) -> PoseEstimate:
        """Let the refiner improve the motion, or find one where the matches gave none."""
        if placement is not None:
            estimate = replace(estimate, instance=placement.instance)
        if estimate.instance is None:
            return estimate
        number, starts = estimate.goal_object, starts_of(estimate)
        if placement is not None:
            starts = (*starts, Start(placement.T_goal_current, independent=False))
        task = RefineTask.of(goal, segments, number, estimate.instance, self.models, starts)
        with self._parts.meter.stage("refiner"):
            refined = self._parts.stages.refiner.refine(task)
        if refined is None:
            return estimate if placement is None or estimate.failure is None else _placed(estimate, placement)
        if isinstance(refined, Failure):
            return replace(estimate, T_goal_current=None, failure=refined)
        return replace(
            estimate,
            T_goal_current=refined.T_goal_current,
            failure=None,
            confidence=refined.confidence * (1.0 if placement is None else placement.trust),
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


def _placed(estimate: PoseEstimate, placement: Placement) -> PoseEstimate:
    """The motion of the explanation, where nothing better is known."""
    return replace(estimate, T_goal_current=placement.T_goal_current, failure=None, confidence=placement.trust)
