"""RANSAC whose hypotheses, scores and refinements are one batched XLA program, compiled once per size of problem."""

from __future__ import annotations

import jax
import numpy as np
from numpy.typing import NDArray

from toolkit.geometry import make_transform
from toolkit.perception.padding import SMALLEST, pad_rows
from toolkit.perception.pnp.solving.base import RobustPnP
from toolkit.perception.pnp.solving.consensus import Problem, polish, search
from toolkit.types import Correspondences, Float

_HYPOTHESES = 256
"""Minimal samples of one round."""
_SEARCHED = SMALLEST
"""Correspondences that hypotheses are drawn from and scored on: a random part when there are more, padding when there
are fewer, so that the search, the long compilation, has one shape. The polish uses all correspondences."""


class JaxRansac(RobustPnP):
    """Batched P3P, vmapped MSAC scores, local optimisation and Levenberg-Marquardt on SE(3).

    In float64, which reaches 1e-13 deg on exact data where float32 stops at 1e-5, and costs no more time on a CPU. The
    switch holds for the call and the thread only, so other users of JAX keep their precision. On the CPU, so that a
    result does not depend on the machine's accelerator; one small problem would not fill it.
    """

    name = "jax_ransac"

    def find_pose(self, problem: Correspondences, seed: int) -> Float | None:
        rng = np.random.default_rng(seed)
        centre = problem.points.mean(axis=0)
        scale = np.sqrt(((problem.points - centre) ** 2).sum(axis=1).mean())
        focal = np.diagonal(problem.K)[:2]
        points, rays = (problem.points - centre) / scale, (problem.pixels - problem.K[:2, 2]) / focal
        subset = rng.permutation(len(problem))[:_SEARCHED]
        samples = _draw_samples(len(subset), self.config.iterations, rng)

        def padded(points: Float, rays: Float) -> Problem:
            valid, threshold = np.ones(len(points), bool), jax.device_put(np.asarray(self.config.reprojection_px))
            return Problem(pad_rows(points), pad_rows(rays), pad_rows(valid), jax.device_put(focal), threshold)

        with jax.enable_x64(True), jax.default_device(jax.local_devices(backend="cpu")[0]):
            pose, cost = search(
                padded(points[subset], rays[subset]),
                jax.device_put(samples),
                jax.device_put(np.asarray(self.config.confidence)),
            )
            pose, cost = jax.device_get((polish(padded(points, rays), pose), cost))
        if not np.isfinite(cost):
            return None
        return make_transform(pose.R, scale * pose.t - pose.R @ centre)


def _draw_samples(n: int, iterations: int, rng: np.random.Generator) -> NDArray[np.int32]:
    """(rounds, hypotheses, 3) distinct rows out of n, uniformly."""
    shape = (-(-iterations // _HYPOTHESES), _HYPOTHESES)
    first, second, third = (rng.integers(n - k, size=shape, dtype=np.int32) for k in range(3))
    # The k-th draw is a place among those not taken: step over the taken ones in rising order.
    second += second >= first
    low, high = np.minimum(first, second), np.maximum(first, second)
    third += third >= low
    third += third >= high
    return np.stack([first, second, third], axis=-1)
