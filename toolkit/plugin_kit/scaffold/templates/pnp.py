"""template: a PnP solver. OpenCV's MAGSAC finds the inliers, Levenberg-Marquardt settles the pose on them."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from pydantic import Field

from toolkit.geometry import make_transform
from toolkit.perception.pnp.solving.base import PnPConfig, RobustPnP
from toolkit.types import Correspondences, Float


class TemplateConfig(PnPConfig):
    """Settings of `template`."""

    polish: bool = Field(True, description="Settle the pose on its inliers by least squares.")


class Template(RobustPnP[TemplateConfig]):
    """MAGSAC++ (Barath et al., CVPR 2020). RobustPnP counts inliers and turns what is degenerate into Failures."""

    name = "template"

    def find_pose(self, problem: Correspondences, seed: int) -> Float | None:
        """Return a (4, 4) T_camera_world that takes the problem's points into the goal camera; None without one."""
        params = cv2.UsacParams()
        params.score = cv2.SCORE_METHOD_MAGSAC
        params.threshold, params.confidence = self.config.reprojection_px, self.config.confidence
        params.maxIterations, params.randomGeneratorState = self.config.iterations, seed % 2**31
        points, pixels, K = problem.points, problem.pixels, problem.K.copy()
        try:
            answer: Any = cv2.solvePnPRansac(points, pixels, K, None, params=params)
            found, _, rvec, tvec, rows = answer
            if not found or rows is None or len(rows) < 4:
                return None
            if self.config.polish:
                rows = np.ravel(rows)
                rvec, tvec = cv2.solvePnPRefineLM(points[rows], pixels[rows], K, None, rvec, tvec)
        except cv2.error:  # raised on degenerate samples
            return None
        return make_transform(np.asarray(cv2.Rodrigues(rvec)[0], np.float64), np.ravel(tvec).astype(np.float64))
