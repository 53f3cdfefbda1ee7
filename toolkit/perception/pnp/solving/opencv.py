"""OpenCV's solvers: USAC finds the inliers, EPnP or SQPnP solves them, Levenberg-Marquardt polishes."""

from __future__ import annotations

from typing import Any, ClassVar

import cv2
import numpy as np

from toolkit.geometry import make_transform
from toolkit.perception.pnp.solving.base import RobustPnP, reprojection_inliers
from toolkit.types import Correspondences, Float

_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-12)
"""OpenCV's own, 20 steps, leave an EPnP start 1e-3 deg short on planar points."""

_REFITS = 10


class OpenCVPnP(RobustPnP):
    """USAC, then the solver of `flag`, then Levenberg-Marquardt."""

    flag: ClassVar[int]

    def find_pose(self, problem: Correspondences, seed: int) -> Float | None:
        # USAC (P3P samples, local optimisation) rather than the classic loop, whose EPnP samples of five points need
        # ten times as many draws at 70 % outliers and break down on planar points. Its state is its own: no global RNG.
        params = cv2.UsacParams()
        params.threshold = self.config.reprojection_px
        params.confidence = self.config.confidence
        params.maxIterations = self.config.iterations
        params.randomGeneratorState = seed % 2**31
        K = problem.K.copy()  # USAC takes it as an output argument too
        try:
            found, _, *start, rows = cv2.solvePnPRansac(problem.points, problem.pixels, K, None, params=params)
            inliers = np.ravel(rows).astype(np.int64) if found else np.zeros(0, np.int64)
            if len(inliers) < 4:
                return None
            points, pixels = problem.points[inliers], problem.pixels[inliers]
            pose = _best_refined(points, pixels, K, [start, *_solutions(points, pixels, K, self.flag)])
            return self._settled(problem, pose)
        except cv2.error:
            # OpenCV raises on degenerate samples; for the caller that is a failed solve.
            return None

    def _settled(self, problem: Correspondences, pose: Float) -> Float:
        """Refit to the pose's own inliers until they no longer change: USAC's belong to an earlier pose."""
        previous = np.zeros(len(problem), bool)
        for _ in range(_REFITS):
            inliers, _ = reprojection_inliers(problem, pose, self.config.reprojection_px)
            if inliers.sum() < 4 or np.array_equal(inliers, previous):
                break
            start = (cv2.Rodrigues(np.array(pose[:3, :3]))[0], np.array(pose[:3, 3:]))
            pose = _best_refined(problem.points[inliers], problem.pixels[inliers], problem.K.copy(), [start])
            previous = inliers
        return pose


def _solutions(points: Float, pixels: Float, K: Float, flag: int) -> list[Any]:
    found, rvec, tvec = cv2.solvePnP(points, pixels, K, None, flags=flag)
    return [(rvec, tvec)] if found else []


def _best_refined(points: Float, pixels: Float, K: Float, starts: list[Any]) -> Float:
    """Polish every (rvec, tvec) and keep the smallest error: on planar points EPnP may start in the wrong valley."""
    best, best_error = np.full((4, 4), np.nan), np.inf
    for rvec, tvec in starts:
        rvec, tvec = cv2.solvePnPRefineLM(points, pixels, K, None, np.array(rvec), np.array(tvec), _CRITERIA)
        error = float(np.linalg.norm(cv2.projectPoints(points, rvec, tvec, K, None)[0].reshape(-1, 2) - pixels))
        if error < best_error:
            best = make_transform(np.asarray(cv2.Rodrigues(rvec)[0], np.float64), np.ravel(tvec).astype(np.float64))
            best_error = error
    return best
