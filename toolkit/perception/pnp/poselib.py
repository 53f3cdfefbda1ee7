"""PoseLib's LO-RANSAC: P3P minimal samples, local optimisation, and non-linear refinement on the inliers."""

from __future__ import annotations

import numpy as np
import poselib

from toolkit.geometry import make_transform
from toolkit.perception.pnp.solving.base import RobustPnP
from toolkit.types import Correspondences, Float


class PoseLib(RobustPnP):
    """PoseLib, Minimal Solvers for Camera Pose Estimation (V. Larsson et al., github.com/PoseLib/PoseLib)."""

    name = "poselib"

    def find_pose(self, problem: Correspondences, seed: int) -> Float | None:
        K, config = problem.K, self.config
        camera = {
            "model": "PINHOLE",
            "width": int(2 * K[0, 2]) + 1,
            "height": int(2 * K[1, 2]) + 1,
            "params": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]],
        }
        ransac = {
            "max_iterations": config.iterations,
            "min_iterations": min(config.iterations, 100),
            "success_prob": config.confidence,
            "max_reproj_error": config.reprojection_px,
            "seed": seed,
        }
        # Outliers are gone by then: plain least squares is the maximum-likelihood answer under pixel noise.
        pose, report = poselib.estimate_absolute_pose(
            problem.pixels, problem.points, camera, ransac, {"loss_type": "TRIVIAL"}
        )
        if report["num_inliers"] == 0:
            return None
        return make_transform(np.asarray(pose.R), np.asarray(pose.t))
