"""What all PnP solvers share: settings, and the checks that turn bad problems and bad poses into Failures."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from pydantic import Field
from typing_extensions import TypeVar

from toolkit.geometry import project
from toolkit.perception.stages import PnP
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Correspondences, Failure, Float, Mask, PnPSolution

_MIN_CORRESPONDENCES = 4
"""Three points leave up to four poses; the fourth decides."""

_COLLINEAR = 1e-3
"""Points whose second extent is below this share of their first lie on a line: the turn about it is not observable."""


class PnPConfig(PluginConfig):
    """Settings every solver understands."""

    reprojection_px: float = Field(1.2, gt=0, le=100, description="Largest reprojection error of an inlier, in pixels.")
    iterations: int = Field(10000, ge=1, le=1_000_000, description="Largest number of minimal samples.")
    min_inliers: int = Field(8, ge=_MIN_CORRESPONDENCES, description="Smallest number of inliers of an accepted pose.")
    confidence: float = Field(
        0.9999, gt=0, lt=1, description="Probability with which at least one sample shall be free of outliers."
    )


PnPConfigT = TypeVar("PnPConfigT", bound=PnPConfig, default=PnPConfig, covariant=True)


class RobustPnP(Plugin[PnPConfigT], PnP):
    """Base of the solvers: a subclass gives the pose, this class says whether it can be believed."""

    stage = "pnp"

    @abstractmethod
    def find_pose(self, problem: Correspondences, seed: int) -> Float | None:
        """Return a (4, 4) T_camera_world that may be wrong or not finite, or None when none was found."""

    def covariance(self, problem: Correspondences, T_camera_world: Float) -> Float | None:
        """Return the (6, 6) covariance of a pose (`PnPSolution`), where the solver knows it."""
        return None

    def solve(self, problem: Correspondences, seed: int) -> PnPSolution | Failure:
        """Return the checked pose and its inliers, or a Failure that says why there is none.

        Inliers are counted here, for every solver alike: in front of the camera and within `reprojection_px`.
        """
        reason = problem_fault(problem, self.config)
        if reason:
            return Failure(self.stage, reason)
        T = self.find_pose(problem, seed)
        if T is None or not np.isfinite(T).all():
            return Failure(self.stage, "no pose agrees with the correspondences")
        inliers, depth = reprojection_inliers(problem, T, self.config.reprojection_px)
        reason = pose_fault(problem, inliers, depth, self.config)
        return Failure(self.stage, reason) if reason else PnPSolution(T, inliers, self.covariance(problem, T))


def problem_fault(problem: Correspondences, config: PnPConfig) -> str | None:
    """Say why a problem cannot be solved by anyone, or None."""
    if len(problem) < config.min_inliers:
        return f"too few correspondences ({len(problem)} of {config.min_inliers} needed)"
    return "the points are collinear or coincide" if _collinear(problem.points) else None


def reprojection_inliers(problem: Correspondences, T: Float, threshold_px: float) -> tuple[Mask, Float]:
    """(N,) bool, reprojected within `threshold_px` and in front of the camera, and the (N,) depths in metres."""
    pixels, depth = project(problem.K, T, problem.points)
    # NaN (behind the camera) compares false.
    return np.linalg.norm(pixels - problem.pixels, axis=1) <= threshold_px, depth


def pose_fault(problem: Correspondences, inliers: Mask, depth: Float, config: PnPConfig) -> str | None:
    """Say why a pose with these inliers and (N,) depths cannot be believed, or None."""
    if np.median(depth) <= 0:
        return "the object is behind the camera"
    if inliers.sum() < config.min_inliers:
        return f"too few inliers ({int(inliers.sum())} among {len(problem)} matches, {config.min_inliers} needed)"
    if _collinear(problem.points[inliers]):
        return "the inliers are collinear or coincide"
    if np.ptp(problem.pixels[inliers], axis=0).max() <= 2 * config.reprojection_px:
        # Any pose that is far enough away explains them.
        return "the inliers are one spot in the image"
    return None


def _collinear(points: Float) -> bool:
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extents[1] <= _COLLINEAR * extents[0])
