"""The goal image matched with the fused model itself, not with one view after another."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import cv2
from pydantic import Field, field_validator

from toolkit.perception.crops import crop_region
from toolkit.perception.fusion import Models, RefineTask
from toolkit.perception.refiners.landmarks.exactness import chance, covariance
from toolkit.perception.refiners.landmarks.landmarks import Landmarks, find, gather
from toolkit.perception.rootsift import root_sift
from toolkit.perception.stages import PNP, Refiner
from toolkit.registry import Plugin, PluginConfig, StageChoice
from toolkit.types import Correspondences, Crop, Failure, Image, PnPSolution, Refined, Segment


class OnePoseConfig(PluginConfig):
    """Settings of `onepose`."""

    ratio: float = Field(
        0.9, gt=0, le=1, description="Largest ratio of the distances to the nearest landmark and to one elsewhere."
    )
    crop_size: int = Field(320, ge=32, description="Side of the crops, in pixels.")
    max_features: int = Field(1000, ge=8, description="Number of keypoints kept per crop, the strongest first.")
    pnp: StageChoice = Field(
        StageChoice(name="poselib"), validate_default=True, description="The solver, with its settings."
    )

    @field_validator("pnp", mode="before")
    @classmethod
    def _checked(cls, value: object) -> StageChoice:
        return PNP.choose(value)


class OnePose(Plugin[OnePoseConfig], Refiner):
    """2D-3D matching against the fused model, as OnePose does (Sun et al., CVPR 2022; He et al., NeurIPS 2022).

    RootSIFT features of all views are lifted to the surface and averaged per point, once for each object; the goal's
    features are matched with these landmarks directly, and PnP solves the result. In place of OnePose's learned
    matching network there are mutual nearest neighbours with a ratio test. It finds its motion without
    the pipeline's starts. Its confidence says how exactly the inliers hold the motion, not whether they are the right
    ones.
    """

    stage = "refiner"
    name = "onepose"

    def __init__(self, config: OnePoseConfig | None = None) -> None:
        super().__init__(config)
        self._landmarks: WeakKeyDictionary[Models, dict[int, Landmarks]] = WeakKeyDictionary()
        self._sift = cv2.SIFT.create(nfeatures=self.config.max_features, contrastThreshold=0.004, edgeThreshold=20)
        self._solver = PNP.create(self.config.pnp.name, self.config.pnp.settings)

    def refine(self, task: RefineTask) -> Refined | Failure:
        model = task.models.get(task.instance)
        if isinstance(model, Failure):
            return model
        problem = self._problem(task)
        solution = self._solver.solve(problem, seed=0)
        if isinstance(solution, Failure):
            return Failure("refiner", f"matched with the fused model: {solution.reason}")
        motion = task.goal.camera.T_world_camera @ solution.T_camera_world
        spread = covariance(problem, motion, solution.inliers, model.center)
        return Refined(motion, chance(spread), motion[None], "none", spread)

    def verify(self, task: RefineTask) -> float | None:
        """Number of the goal's features that agree on one motion of the instance."""
        if isinstance(task.models.get(task.instance), Failure):
            return None
        solution = self._solver.solve(self._problem(task), seed=0)
        return float(solution.inliers.sum()) if isinstance(solution, PnPSolution) else 0.0

    def _problem(self, task: RefineTask) -> Correspondences:
        """What of the object's landmarks is seen where in the goal image."""
        landmarks, crop = self._known(task), self._crop(task.goal.rgb, task.segment)
        features = root_sift(self._sift, crop, border_px=2)
        rows, seen, scores = find(landmarks, features.descriptors, self.config.ratio)
        return Correspondences(landmarks.points[seen], crop.to_image(features.xy[rows]), scores, task.goal.camera)

    def _known(self, task: RefineTask) -> Landmarks:
        """The instance's landmarks, made once for each scene."""
        known = self._landmarks.setdefault(task.models, {})
        model = task.models.get(task.instance)
        if task.instance not in known and not isinstance(model, Failure):
            crops = [self._crop(patch.rgb, Segment(patch.mask)) for patch in model.patches]
            known[task.instance] = gather(model.patches, crops, [root_sift(self._sift, crop, 2) for crop in crops])
        return known[task.instance]

    def _crop(self, rgb: Image, segment: Segment) -> Crop:
        return crop_region(rgb, segment, self.config.crop_size)
