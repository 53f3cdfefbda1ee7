"""Frames and goal image -> database -> pose estimates. No I/O, and no knowledge of which stage is behind a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.perception.assignment import assign_instances, contenders, instance_similarity, restrict, true_instances
from toolkit.perception.crops import crop_region
from toolkit.perception.database import Database
from toolkit.perception.fusion import Models, RefineTask, Start
from toolkit.perception.lifting import lift_matches, merge
from toolkit.perception.meter import Meter
from toolkit.perception.regions import lift_segment
from toolkit.perception.stages import (
    AdaptiveDescriptor,
    Associator,
    Descriptor,
    Index,
    Matcher,
    PnP,
    Refiner,
    Registration,
    Retriever,
    Segmenter,
)
from toolkit.registry import PluginConfig
from toolkit.types import (
    Capture,
    Correspondences,
    Crop,
    Failure,
    Float,
    Frame,
    PnPSolution,
    PoseEstimate,
    Region,
    Segment,
)


class PipelineSettings(PluginConfig):
    """What the pipeline itself decides, besides its stages."""

    views: int | Literal["all"] = Field(
        default="all", description="Current frames used, evenly spaced from the first; or all."
    )
    fuse: Literal["all", "first"] = Field(
        default="all",
        description="Solve from all accepted candidates of the instance, or from the first accepted (the paper).",
    )
    min_matches: int = Field(default=6, ge=3, description="Lifted matches a candidate needs to be accepted.")
    assignment: Literal["vote", "global", "truth"] = Field(
        default="vote",
        description="Goal objects choose their instance on their own (the paper), each instance is given once, or "
        "every object gets its true one (to measure what retrieval costs).",
    )
    crop_margin: float = Field(default=0.05, ge=0, le=1, description="Free border of a crop, as a part of its box.")


_DEFAULTS = PipelineSettings()


@dataclass(frozen=True)
class Stages:
    """One implementation for every stage of the perception module."""

    registration: Registration
    segmenter: Segmenter
    goal_segmenter: Segmenter
    associator: Associator
    descriptor: Descriptor
    index: Index
    retriever: Retriever
    matcher: Matcher
    pnp: PnP
    refiner: Refiner


@dataclass(frozen=True)
class _Accepted:
    row: int
    correspondences: Correspondences


@dataclass
class _Search:
    """What trying one goal object's candidates has found so far."""

    accepted: list[_Accepted] = field(default_factory=list[_Accepted])
    first: int | None = None
    matcher_calls: int = 0
    most_matches: int = 0


@dataclass(frozen=True)
class Pipeline:
    """The perception module of Sec. Method A.

    Args:
        stages: the implementations.
        settings: the pipeline's own choices.
        seed: makes every random choice; the same seed gives the same bytes.
        meter: where stage times go; share it with caching wrappers.
    """

    stages: Stages
    settings: PipelineSettings = _DEFAULTS
    seed: int = 0
    meter: Meter = field(default_factory=Meter)
    _kept: list[tuple[_References, Models]] = field(
        default_factory=list[tuple["_References", Models]], init=False, repr=False, compare=False
    )

    def run(self, capture: Capture) -> list[PoseEstimate]:
        """Estimate the motion of every goal object of a capture."""
        database = self.build_database(capture.current)
        return self.estimate(database, capture.goal)

    def build_database(self, frames: Sequence[Frame]) -> Database:
        """Database construction: segment, lift, associate and describe every region of the chosen frames.

        Raises:
            ToolkitError: more views are asked for than there are, or a stage refuses its input.
        """
        frames = self._choose_views(frames)
        with self.meter.stage("registration"):
            frames = self.stages.registration.register(frames)
        regions: list[Region] = []
        dropped = 0
        with self.meter.stage("segmenter"):
            segments = [(frame, s) for frame in frames for s in self.stages.segmenter.segment(frame, frames)]
            for frame, segment in segments:
                lifted = lift_segment(frame, segment)
                if isinstance(lifted, Region):
                    regions.append(lifted)
                else:
                    dropped += 1
        if not regions:
            return Database(tuple(frames), (), np.zeros(0, np.int64), np.zeros((0, 1), np.float32), dropped)
        with self.meter.stage("associator"):
            instances = self.stages.associator.associate(regions, frames)
        frame_of = {frame.index: frame for frame in frames}
        with self.meter.stage("descriptor"):
            size = self.stages.descriptor.crop_size
            margin = self.settings.crop_margin
            crops = [crop_region(frame_of[r.frame_index].rgb, r.segment, size, margin) for r in regions]
            descriptors = self.stages.descriptor.describe(crops)
        return Database(tuple(frames), tuple(regions), instances, descriptors, dropped)

    def estimate(self, database: Database, goal: Frame) -> list[PoseEstimate]:
        """Pose estimation: one estimate for every object segmented in the goal image.

        The database's share of the time is spread evenly over the objects. What is made of the database on the way,
        features of its regions and fused models, is kept for further goals until another database comes.
        """
        with self.meter.stage("registration"):
            goal = self.stages.registration.locate(goal, database.frames)
        with self.meter.stage("segmenter"):
            segments = self.stages.goal_segmenter.segment(goal, database.frames)
        if not segments:
            return []
        references, models = self._prepared(database)
        rankings: list[np.ndarray] = []
        queries: Float | None = None
        if len(database):
            with self.meter.stage("descriptor"):
                size = self.stages.descriptor.crop_size
                margin = self.settings.crop_margin
                queries = self.stages.descriptor.describe([crop_region(goal.rgb, s, size, margin) for s in segments])
                database, queries = self._adapt(database, queries)
            with self.meter.stage("index"):
                self.stages.index.build(database.descriptors)
                rankings = list(self.stages.index.search(queries, len(database))[1])
        if queries is not None and self.settings.assignment == "global":
            scores = instance_similarity(queries @ database.descriptors.T, database.instances)
            chosen = assign_instances(scores, self._verify(goal, segments, scores, models))
            rankings = [restrict(r, database.instances, int(i)) for r, i in zip(rankings, chosen, strict=True)]
        elif rankings and self.settings.assignment == "truth":
            chosen = true_instances(database, goal, segments)
            rankings = [restrict(r, database.instances, int(i)) for r, i in zip(rankings, chosen, strict=True)]
        shared_ms, shared_cached = self.meter.take()
        shared_ms = {stage: time / len(segments) for stage, time in shared_ms.items()}
        estimates: list[PoseEstimate] = []
        for number, segment in enumerate(segments):
            if rankings:
                estimate = self._estimate_object(references, goal, number, segment, rankings[number])
                estimate = self._refine(estimate, goal, segments, models)
            else:
                failure = Failure("segmenter", "no object region was found in the current frames")
                estimate = PoseEstimate(number, segment, None, None, failure)
            own_ms, own_cached = self.meter.take()
            time_ms = {s: shared_ms.get(s, 0.0) + own_ms.get(s, 0.0) for s in {**shared_ms, **own_ms}}
            estimates.append(replace(estimate, time_ms=time_ms, cached=shared_cached or own_cached))
        return estimates

    def _prepared(self, database: Database) -> tuple[_References, Models]:
        """What depends on the database alone, made when first needed."""
        if not self._kept or self._kept[0][0].database is not database:
            references = _References(database, self.stages.matcher, self.settings.crop_margin)
            self._kept[:] = [(references, Models(database))]
        return self._kept[0]

    def _estimate_object(
        self, references: _References, goal: Frame, number: int, segment: Segment, ranking: np.ndarray
    ) -> PoseEstimate:
        database = references.database
        search = self._search(references, goal, segment, ranking)
        if not search.accepted:
            reason = f"no candidate reached {self.settings.min_matches} lifted matches (best: {search.most_matches})"
            failure = Failure("matcher", reason)
            instance = None if search.first is None else int(database.instances[search.first])
            return PoseEstimate(number, segment, instance, None, failure, matcher_calls=search.matcher_calls)
        best: PoseEstimate | None = None
        for instance in dict.fromkeys(int(database.instances[a.row]) for a in search.accepted):
            accepted = [a for a in search.accepted if database.instances[a.row] == instance]
            estimate = self._solve(accepted, goal, number, segment, instance)
            if best is None or _support(estimate) > _support(best):
                best = estimate
        assert best is not None
        return replace(best, matcher_calls=search.matcher_calls)

    def _adapt(self, database: Database, queries: Float) -> tuple[Database, Float]:
        """Database and queries as the descriptor sees them once it has learnt from the scene, where it can."""
        descriptor = self.stages.descriptor
        if not isinstance(descriptor, AdaptiveDescriptor):
            return database, queries
        adaptation = descriptor.adapt(database.descriptors, database.instances)
        return replace(database, descriptors=adaptation(database.descriptors)), adaptation(queries)

    def _verify(self, goal: Frame, segments: Sequence[Segment], scores: Float, models: Models) -> Float:
        """(Q, K) how well instances that contend for a goal object agree with it, by the refiner; NaN elsewhere."""
        verified = np.full(scores.shape, np.nan)
        with self.meter.stage("refiner"):
            for number, instance in np.argwhere(contenders(scores)):
                task = RefineTask(goal, segments[number], _others(segments, number), int(instance), models)
                score = self.stages.refiner.verify(task)
                verified[number, instance] = np.nan if score is None else score
        return verified

    def _refine(self, estimate: PoseEstimate, goal: Frame, segments: Sequence[Segment], models: Models) -> PoseEstimate:
        """Let the refiner improve the motion, or find one where the matches gave none."""
        if estimate.instance is None:
            return estimate
        others = _others(segments, estimate.goal_object)
        task = RefineTask(goal, estimate.segment, others, estimate.instance, models, starts_of(estimate))
        with self.meter.stage("refiner"):
            refined = self.stages.refiner.refine(task)
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

    def _search(self, references: _References, goal: Frame, segment: Segment, ranking: np.ndarray) -> _Search:
        """Try candidates in the retriever's order; stop at the first accepted one when `fuse` is `first`."""
        database, search = references.database, _Search()
        with self.meter.stage("retriever"):
            traversal = self.stages.retriever.start(ranking, database.instances, database.observations)
        query_crop = crop_region(goal.rgb, segment, self.stages.matcher.crop_size, self.settings.crop_margin)
        with self.meter.stage("matcher"):
            query = self.stages.matcher.extract([query_crop])[0]
        batch = 1 if self.settings.fuse == "first" else len(database)
        while rows := traversal.next(batch):
            search.first = rows[0] if search.first is None else search.first
            with self.meter.stage("matcher"):
                matches = self.stages.matcher.match(query, references.features(rows))
            search.matcher_calls += len(rows)
            for row, found in zip(rows, matches, strict=True):
                region = database.regions[row]
                lifted = lift_matches(
                    found, query_crop, references.crops[row], database.frame_of(row), region.segment.mask, goal.camera
                )
                search.most_matches = max(search.most_matches, len(lifted))
                if len(lifted) >= self.settings.min_matches and self._acceptable(lifted):
                    search.accepted.append(_Accepted(row, lifted))
                else:
                    traversal.reject(row)
            if self.settings.fuse == "first" and search.accepted:
                break
        return search

    def _acceptable(self, lifted: Correspondences) -> bool:
        """With `first`, a candidate whose matches admit no pose is rejected, and the traversal goes on."""
        if self.settings.fuse == "all":
            return True
        with self.meter.stage("pnp"):
            return isinstance(self.stages.pnp.solve(lifted, self.seed), PnPSolution)

    def _solve(
        self, accepted: list[_Accepted], goal: Frame, number: int, segment: Segment, instance: int
    ) -> PoseEstimate:
        problem = merge([a.correspondences for a in accepted])
        candidates = tuple((a.row, len(a.correspondences)) for a in accepted)
        with self.meter.stage("pnp"):
            solution = self.stages.pnp.solve(problem, self.seed)
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

    def _choose_views(self, frames: Sequence[Frame]) -> list[Frame]:
        views = self.settings.views
        if views == "all":
            return list(frames)
        if not 1 <= views <= len(frames):
            raise ToolkitError(f"pipeline.views is {views}, but the capture has {len(frames)} current frames")
        return [frames[len(frames) * i // views] for i in range(views)]


class _References:
    """Candidate crops and features of one database, made when first asked for and used for every goal object."""

    def __init__(self, database: Database, matcher: Matcher, crop_margin: float) -> None:
        self.database = database
        self.crops: dict[int, Crop] = {}
        self._features: dict[int, object] = {}
        self._matcher = matcher
        self._crop_margin = crop_margin

    def features(self, rows: Sequence[int]) -> list[object]:
        """The matcher's features of regions `rows`, extracting the missing ones in one batch."""
        missing = [row for row in rows if row not in self._features]
        if missing:
            for row in missing:
                rgb, segment = self.database.frame_of(row).rgb, self.database.regions[row].segment
                self.crops[row] = crop_region(rgb, segment, self._matcher.crop_size, self._crop_margin)
            extracted = self._matcher.extract([self.crops[row] for row in missing])
            self._features.update(zip(missing, extracted, strict=True))
        return [self._features[row] for row in rows]


def starts_of(estimate: PoseEstimate) -> tuple[Start, ...]:
    """What PnP found, as a refiner may start from it."""
    if estimate.T_goal_current is None or estimate.correspondences is None:
        return ()
    return (Start(estimate.T_goal_current, estimate.covariance, estimate.correspondences.points.mean(axis=0)),)


def _others(segments: Sequence[Segment], number: int) -> tuple[Segment, ...]:
    """All goal segments but one."""
    return (*segments[:number], *segments[number + 1 :])


def _support(estimate: PoseEstimate) -> int:
    """Inliers behind an estimate; a failure has fewer than any solution."""
    return -1 if estimate.inliers is None else int(estimate.inliers.sum())
