"""Frames and goal image -> database -> pose estimates. No I/O, and no knowledge of which stage is behind a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.perception.crops import crop_region
from toolkit.perception.database import Database
from toolkit.perception.level import measure_level
from toolkit.perception.parts import Parts, PipelineSettings, Stages
from toolkit.perception.regions import lift_segment
from toolkit.perception.scene import Scene
from toolkit.types import Capture, Frame, PoseEstimate, Region

__all__ = ["Pipeline", "PipelineSettings", "Scene", "Stages"]


@dataclass(frozen=True)
class Pipeline(Parts):
    """The perception module of Sec. Method A, made of these parts. It keeps nothing of what it has seen."""

    def run(self, capture: Capture) -> list[PoseEstimate]:
        """Estimate the motion of every goal object of a capture."""
        return self.estimate(self.build_database(capture.current), capture.goal)

    def build_database(self, frames: Sequence[Frame]) -> Database:
        """Database construction: segment, lift, associate and describe every region of the chosen frames.

        Stages work in the table's own frame, wherever it lies; the database is in the world of the frames.

        Raises:
            ToolkitError: more views are asked for than there are, or a stage refuses its input.
        """
        frames = self._choose_views(frames)
        with self.meter.stage("registration"):
            frames = self.stages.registration.register(frames)
            T_world_level = measure_level(frames)
        if T_world_level is None:
            return self._build(frames)
        level = invert(T_world_level)
        return self._build([frame.moved(level) for frame in frames]).placed(T_world_level)

    def _build(self, frames: Sequence[Frame]) -> Database:
        """The database of registered frames, in their own world."""
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
            size, margin = self.stages.descriptor.crop_size, self.settings.crop_margin
            crops = [crop_region(frame_of[r.frame_index].rgb, r.segment, size, margin) for r in regions]
            descriptors = self.stages.descriptor.describe(crops)
        return Database(tuple(frames), tuple(regions), instances, descriptors, dropped)

    def scene(self, database: Database) -> Scene:
        """The scene of a database, for several goals: it keeps what it makes of the database on the way."""
        return Scene(self, database)

    def estimate(self, database: Database, goal: Frame) -> list[PoseEstimate]:
        """Pose estimation: one estimate for every object segmented in the goal image (`Scene.estimate`).

        An explainer may find instances to be one object; who needs the database as the goal shows it asks `scene`.
        """
        return self.scene(database).estimate(goal)

    def _choose_views(self, frames: Sequence[Frame]) -> list[Frame]:
        views = self.settings.views
        if views == "all":
            return list(frames)
        if views > len(frames):
            raise ToolkitError(f"pipeline.views is {views}, but the capture has {len(frames)} current frames")
        return [frames[len(frames) * i // views] for i in range(views)]
