"""Where the light of a scene comes from, seen in how the brightness of its objects depends on their surfaces' normals.

A turned object is shaded anew: sides that were lit turn away. For small contrasts Lambert's law is log-linear, log
brightness = log albedo + light . normal; and over many objects the albedo is no function of the normal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolkit.perception.fusion import FusedModel
from toolkit.types import Float

_POINTS = 512
_LEAST_POINTS = 100
_DARKEST = 5.0
"""Grey levels: below, noise decides."""


def estimate_light(models: Sequence[FusedModel]) -> Float:
    """Estimate the light of a scene.

    Returns:
        (3,) float64 in world coordinates: change of log brightness by unit normal. The median over the objects, so that
        single ones whose colours happen to differ by side do not matter. 0 where no model is large enough.
    """
    slopes = [_slope(model) for model in models if len(model.points) >= _LEAST_POINTS]
    return np.median(slopes, axis=0) if slopes else np.zeros(3)


def _slope(model: FusedModel) -> Float:
    """(3,) least-squares slope of log brightness by normal."""
    rows = np.random.default_rng(0).permutation(len(model.points))[:_POINTS]
    brightness = np.log(np.maximum(model.colors[rows].mean(axis=1), _DARKEST)).astype(np.float64)
    A = np.column_stack([np.ones(len(rows)), model.normals_at(rows)])
    return np.linalg.lstsq(A, brightness, rcond=1e-3)[0][1:]


def relit(light: Float, normals: Float, R: Float) -> Float:
    """(..., N) factors of brightness of a surface with (N, 3) normals once it is turned by (..., 3, 3) R."""
    turned_light = light @ R
    return np.exp(turned_light @ normals.T - normals @ light)
