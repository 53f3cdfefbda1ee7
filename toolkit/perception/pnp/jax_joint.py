"""All correspondences of an instance in one weighted robust problem, on the table or free, with its covariance."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.geometry import invert, make_transform, transform_points
from toolkit.perception.padding import pad_rows
from toolkit.perception.pnp.jax_ransac import JaxRansac
from toolkit.perception.pnp.solving.base import PnPConfig, RobustPnP
from toolkit.perception.pnp.solving.damped import Pose
from toolkit.perception.pnp.solving.joint import Evidence, covariance, polish, search_planar
from toolkit.types import Correspondences, Float

_SAMPLES = 2048
"""Pairs of points that hypotheses on the table are made from: with two points few samples hold an outlier."""

_LEAST = 512
"""Matches that problems are filled up to: what few objects need less is less than another program to compile."""


class JointConfig(PnPConfig):
    """Settings of `jax_joint`."""

    prior: Literal["planar", "none"] = Field(
        "planar",
        description="`planar`: objects turn about the vertical and slide on the table; `none`: they move freely.",
    )


class JaxJoint(RobustPnP[JointConfig]):
    """Weighted M-estimation over all candidates' matches by Levenberg-Marquardt, with covariance.

    Matches count by their score. Under the planar prior two of them make a hypothesis; without it the search is that of
    `jax_ransac`. In float64 on the CPU, as there.
    """

    name = "jax_joint"

    def find_pose(self, problem: Correspondences, seed: int) -> Float | None:
        center = problem.points.mean(axis=0)
        with _float64_on_cpu():
            evidence = self._evidence(problem, center)
            if self.config.prior == "planar":
                samples = jax.device_put(_draw_pairs(problem.weights, seed))
                start = search_planar(evidence, samples, jax.device_put(center[2]))
            else:
                T = JaxRansac(self.config).find_pose(problem, seed)
                if T is None:
                    return None
                start = _motion(problem, T, center)
            R, t = jax.device_get(polish(evidence, start, self._free()))
        return invert(problem.camera.T_world_camera) @ make_transform(R, t - R @ center)

    def covariance(self, problem: Correspondences, T_camera_world: Float) -> Float:
        center = problem.points.mean(axis=0)
        with _float64_on_cpu():
            motion = _motion(problem, T_camera_world, center)
            return np.asarray(covariance(self._evidence(problem, center), motion, self._free()))

    def _evidence(self, problem: Correspondences, center: Float) -> Evidence:
        focal = np.diagonal(problem.K)[:2]
        T = invert(problem.camera.T_world_camera)
        padded = (problem.points - center, (problem.pixels - problem.K[:2, 2]) / focal, problem.weights)
        fixed = (focal, T[:3, :3], T[:3, 3], np.asarray(self.config.reprojection_px))
        return Evidence(*(pad_rows(array, _LEAST) for array in padded), *map(jax.device_put, fixed))

    def _free(self) -> jax.Array:
        return jnp.array([0.0, 0, 1, 1, 1, 0]) if self.config.prior == "planar" else jnp.ones(6)


def _float64_on_cpu() -> ExitStack:
    stack = ExitStack()
    stack.enter_context(jax.enable_x64(True))
    stack.enter_context(jax.default_device(jax.local_devices(backend="cpu")[0]))
    return stack


def _motion(problem: Correspondences, T_camera_world: Float, center: Float) -> Pose:
    T = problem.camera.T_world_camera @ T_camera_world
    return Pose(jax.device_put(T[:3, :3]), jax.device_put(transform_points(T, center)))


def _draw_pairs(weights: Float, seed: int) -> NDArray[np.int32]:
    """(_SAMPLES, 2) different rows, drawn by weight."""
    rng = np.random.default_rng(seed)
    share = weights + 1e-6
    first, second = rng.choice(len(weights), (2, _SAMPLES), p=share / share.sum())
    second = np.where(second == first, (second + 1) % len(weights), second)
    return np.stack([first, second], axis=1).astype(np.int32)
