"""Hypotheses all around, rendered, compared and refined: the road past sparse matches."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Literal
from weakref import WeakKeyDictionary

import numpy as np
from pydantic import Field
from typing_extensions import TypeVar

from toolkit.perception.fusion import Models, RefineTask, Start
from toolkit.perception.lighting import estimate_light
from toolkit.perception.refiners.comparing.cloud import Cloud
from toolkit.perception.refiners.comparing.combine import combine
from toolkit.perception.refiners.comparing.compare import FREE, PLANAR, Search, best_agreement, compare
from toolkit.perception.refiners.comparing.goal import LEVELS_PX, view_goal
from toolkit.perception.refiners.comparing.rotations import resting_rotations, yaw_rotations
from toolkit.perception.refiners.comparing.verdict import Verdict, judge
from toolkit.perception.stages import Refiner
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Abstention, Failure, Float, Refined


class RefinerConfig(PluginConfig):
    """Settings of the refiners that compare images."""

    prior: Literal["planar", "resting", "none"] = Field(
        "planar",
        description="`planar`: objects turn about the vertical and slide on the table; `resting`: they may rest on "
        "any side; `none`: they move freely.",
    )
    patches: int = Field(
        2, ge=1, le=8, description="Number of views with which a hypothesis is compared, the nearest first."
    )
    iterations: int = Field(
        8, ge=0, description="Gauss-Newton steps per level; with 0, hypotheses stay as they are found."
    )
    abstain_below: float = Field(0.05, ge=0, le=1, description="Answers with less confidence than this are withheld.")
    min_pixels: int = Field(
        30, ge=1, description="An object of which the goal image shows fewer pixels than this is not judged."
    )
    same_score: float = Field(
        0.03, ge=0, description="Hypotheses whose score is this close to the best one count as equally good."
    )


class RenderCompareConfig(RefinerConfig):
    """Settings of `render_compare`."""

    yaws: int = Field(72, ge=4, description="Number of turns about the vertical that are tried.")
    rests: int = Field(
        26,
        ge=1,
        description="Without the planar prior: number of sides that are put up, stable ones first, each in a third "
        "of the yaws.",
    )
    kept: int = Field(10, ge=2, description="Number of best hypotheses that are refined, starts included.")
    use_starts: bool = Field(True, description="Whether the motion that PnP found competes with the hypotheses.")


@dataclass
class _Scene:
    """What is kept of a scene while its models live; nothing in it may refer to those, or they would live for ever."""

    light: Float
    clouds: dict[int, tuple[Cloud, Search]] = field(default_factory=dict[int, tuple[Cloud, Search]])


RefinerConfigT = TypeVar("RefinerConfigT", bound=RefinerConfig, default=RefinerConfig, covariant=True)


class ImageRefiner(Plugin[RefinerConfigT], Refiner):
    """Base of the refiners: fused model against goal image. A subclass says which hypotheses there are."""

    stage = "refiner"

    def __init__(self, config: RefinerConfigT | None = None) -> None:
        super().__init__(config)
        self._scenes: WeakKeyDictionary[Models, _Scene] = WeakKeyDictionary()

    @abstractmethod
    def search(self, cloud: Cloud) -> Search:
        """How hypotheses for an object are made."""

    def starts(self, task: RefineTask) -> tuple[Start, ...]:
        """Motions of other routes that compete."""
        return task.starts

    def refine(self, task: RefineTask) -> Refined | Failure:
        """Return the hypothesis that agrees best with the goal image, or why none is believed."""
        seen = int(task.segment.mask.sum())
        if seen < self.config.min_pixels:
            return Abstention(
                "refiner", f"{seen} pixels of the object are in view, at least {self.config.min_pixels} decide"
            )
        prepared = self._prepared(task)
        if isinstance(prepared, Failure):
            return prepared
        (cloud, search), starts = prepared, self.starts(task)
        if not starts and not len(search.rotations):
            return Failure("refiner", "there is no motion to refine")
        goal = view_goal(task.goal, task.segment, task.others)
        found = compare(cloud, goal, [start.T_goal_current for start in starts], search)
        if not found:
            return Failure("refiner", "no hypothesis stayed finite")
        return self._answer(judge(found, cloud.model, starts, self.config.same_score), cloud.center, search.free)

    def verify(self, task: RefineTask) -> float | None:
        prepared = self._prepared(task)
        if isinstance(prepared, Failure):
            return None
        cloud, search = prepared
        return best_agreement(cloud, view_goal(task.goal, task.segment, task.others), search)

    def _prepared(self, task: RefineTask) -> tuple[Cloud, Search] | Failure:
        """The instance's cloud and the hypotheses for it, made once per scene."""
        model = task.models.get(task.instance)
        if isinstance(model, Failure):
            return model
        if task.models not in self._scenes:
            self._scenes[task.models] = _Scene(estimate_light(task.models.all()))
        scene = self._scenes[task.models]
        if task.instance not in scene.clouds:
            table = None if self.config.prior == "planar" else task.models.table_height(model.center[:2])
            cloud = Cloud(model, LEVELS_PX, scene.light, table)
            scene.clouds[task.instance] = cloud, self.search(cloud)
        return scene.clouds[task.instance]

    def _answer(self, verdict: Verdict, center: Float, free: Float) -> Refined | Failure:
        sure, least = verdict.confidence, self.config.abstain_below
        if sure < least:
            return Abstention("refiner", f"confidence {sure:.2f} is below {least:g}")
        motion, covariance = verdict.best.T_goal_current, _covariance(verdict.best.information, free)
        exact = next((start for start in verdict.supporters if start.covariance is not None), None)
        if exact is not None:
            motion, covariance = combine(motion, covariance, center, exact, free)
        others = [h.T_goal_current for h in verdict.equivalents[1:]]
        return Refined(motion, sure, np.stack([motion, *others]), verdict.ambiguity, covariance)


def _covariance(information: Float, free: Float) -> Float:
    rows = np.flatnonzero(free)
    covariance = np.zeros((6, 6))
    covariance[np.ix_(rows, rows)] = np.linalg.pinv(information[np.ix_(rows, rows)], hermitian=True)
    return covariance


class RenderCompare(ImageRefiner[RenderCompareConfig]):
    """Renders the fused model in every yaw (or rotation), refines the best, and verifies them with PnP's answer."""

    name = "render_compare"

    def search(self, cloud: Cloud) -> Search:
        c = self.config
        if c.prior == "planar":
            return Search(yaw_rotations(c.yaws), PLANAR, False, c.kept, c.patches, c.iterations)
        rotations = resting_rotations(cloud.points, c.rests, max(c.yaws // 3, 1))
        return Search(rotations, FREE, c.prior == "resting", c.kept, c.patches, c.iterations)

    def starts(self, task: RefineTask) -> tuple[Start, ...]:
        return task.starts[: self.config.kept - 1] if self.config.use_starts else ()
