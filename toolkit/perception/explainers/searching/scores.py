"""How well sampled models agree with a goal image under many motions at once (JAX)."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from toolkit.perception.explainers.searching.evidence import MOST_COST, Evidence
from toolkit.perception.padding import pad_rows
from toolkit.types import Float

_GRAZING = 0.1
"""Cosine to the camera below which a surface is not compared."""

_BATCH = 384
"""Thirteen hypotheses, each moved in 27 ways, fill one batch."""

_LEAST_PIXELS = 1 << 17
"""Images are filled up to this many pixels, so that one program serves most of them."""


class Sample(NamedTuple):
    """Some points of a model, centred, in the table's axes; what pads it has no weight.

    Attributes:
        points: (N, 3) float32 metres.
        normals: (N, 3) float32 outward.
        colours: (N, 3) float32, as `evidence.scaled` gives them.
        weights: (N,) float32.
    """

    points: Float
    normals: Float
    colours: Float
    weights: Float


class Scorer:
    """Scores motions of models by one goal image.

    A point counts by how much better the model explains its pixel than what is known to be there; what faces away, is
    hidden or lies outside the image counts nothing.

    Args:
        goal: the image.
        T_camera_table: (4, 4).
    """

    def __init__(self, goal: Evidence, T_camera_table: Float) -> None:
        pixels = goal.colours.reshape(-1, 3), goal.background.ravel(), goal.depth.ravel()
        self._goal = (
            *(pad_rows(array.astype(np.float32), _LEAST_PIXELS) for array in pixels),
            np.array(goal.background.shape, np.int32),
            goal.K.astype(np.float32),
            T_camera_table.astype(np.float32),
        )

    def score(self, sample: Sample, turns: Float, places: Float) -> Float:
        """(B,) mean gain in cost over all points, higher is better.

        Args:
            sample: the model.
            turns: (B,) yaw, radians.
            places: (B, 3) of its centre in the table's frame, metres.
        """
        count = len(turns)
        padding = -count % _BATCH
        yaw = np.pad(turns, (0, padding)).astype(np.float32).reshape(-1, _BATCH)
        place = np.pad(places, ((0, padding), (0, 0)), mode="edge").astype(np.float32).reshape(-1, _BATCH, 3)
        scores = [_score(*sample, y, p, *self._goal) for y, p in zip(yaw, place, strict=True)]
        return np.concatenate([np.asarray(s) for s in scores])[:count]


@jax.jit
def _score(
    points: jax.Array,
    normals: jax.Array,
    colours: jax.Array,
    weights: jax.Array,
    yaw: jax.Array,
    place: jax.Array,
    image: jax.Array,
    background: jax.Array,
    nearest: jax.Array,
    size: jax.Array,
    K: jax.Array,
    T: jax.Array,
) -> jax.Array:
    eye = -T[:3, :3].T @ T[:3, 3]
    one = partial(_gain, points, normals, colours, weights, image, background, nearest, size, K, T, eye)
    return jax.vmap(one)(yaw, place)


def _gain(
    points: jax.Array,
    normals: jax.Array,
    colours: jax.Array,
    weights: jax.Array,
    image: jax.Array,
    background: jax.Array,
    nearest: jax.Array,
    size: jax.Array,
    K: jax.Array,
    T: jax.Array,
    eye: jax.Array,
    yaw: jax.Array,
    place: jax.Array,
) -> jax.Array:
    c, s = jnp.cos(yaw), jnp.sin(yaw)
    x, y, z = points.T
    placed = jnp.stack([c * x - s * y, s * x + c * y, z], axis=1) + place
    nx, ny, nz = normals.T
    view = eye - place
    view /= jnp.linalg.norm(view)
    front = (c * nx - s * ny) * view[0] + (s * nx + c * ny) * view[1] + nz * view[2] > _GRAZING
    camera = placed @ T[:3, :3].T + T[:3, 3]
    depth = jnp.maximum(camera[:, 2], 1e-3)
    column = jnp.round(camera[:, 0] / depth * K[0, 0] + K[0, 2]).astype(jnp.int32)
    row = jnp.round(camera[:, 1] / depth * K[1, 1] + K[1, 2]).astype(jnp.int32)
    inside = (column >= 0) & (column < size[1]) & (row >= 0) & (row < size[0])
    index = jnp.where(inside, row * size[1] + column, 0)
    gap = image[index] - colours
    own = jnp.minimum((gap * gap).sum(axis=1), MOST_COST)
    shown = inside & front & (depth < nearest[index])
    return (weights * shown * (background[index] - own)).sum() / weights.sum()
