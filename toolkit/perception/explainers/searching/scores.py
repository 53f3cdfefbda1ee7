"""How well sampled models agree with a goal image under many motions at once (JAX)."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float32, Int32

from toolkit.perception.compiled import Compiled
from toolkit.perception.explainers.searching.evidence import MOST_COST, Evidence
from toolkit.perception.jax_geometry import rotated
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
        pixels = np.column_stack([goal.colours.reshape(-1, 3), goal.background.ravel(), goal.depth.ravel()])
        self._goal = jax.device_put(
            (
                pad_rows(pixels.astype(np.float32), _LEAST_PIXELS),
                np.array(goal.background.shape, np.int32),
                goal.K.astype(np.float32),
                T_camera_table.astype(np.float32),
            )
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


@Compiled
def _score(
    points: Float32[Array, "N 3"],
    normals: Float32[Array, "N 3"],
    colours: Float32[Array, "N 3"],
    weights: Float32[Array, " N"],
    yaw: Float32[Array, " B"],
    place: Float32[Array, "B 3"],
    pixels: Float32[Array, "P 5"],
    size: Int32[Array, " 2"],
    K: Float32[Array, "3 3"],
    T: Float32[Array, "4 4"],
) -> Float32[Array, " B"]:
    """Mean gains, given the pixels of an image (H, W) of this size: colours, cost and depth of what is known there."""
    (nx, ny, nz), eye = normals.T, -T[:3, :3].T @ T[:3, 3]

    def gain(yaw: Float32[Array, ""], place: Float32[Array, " 3"]) -> Float32[Array, ""]:
        c, s = jnp.cos(yaw), jnp.sin(yaw)
        turn = jnp.stack([T[:3, 0] * c + T[:3, 1] * s, T[:3, 1] * c - T[:3, 0] * s, T[:3, 2]], axis=1)
        shift = T[:3, :3] @ place + T[:3, 3]
        right, down, ahead = (turned + t for turned, t in zip(rotated(turn, points), shift, strict=True))
        view = eye - place
        view /= jnp.linalg.norm(view)
        front = (c * view[0] + s * view[1]) * nx + (c * view[1] - s * view[0]) * ny + view[2] * nz > _GRAZING
        depth = jnp.maximum(ahead, 1e-3)
        column = jnp.round(right / depth * K[0, 0] + K[0, 2]).astype(jnp.int32)
        row = jnp.round(down / depth * K[1, 1] + K[1, 2]).astype(jnp.int32)
        inside = (column >= 0) & (column < size[1]) & (row >= 0) & (row < size[0])
        *colour, cost, known = pixels[jnp.where(inside, row * size[1] + column, 0)].T
        # Channel by channel, since a sum over an axis of three is a loop of its own.
        gap = sum((seen - wanted) ** 2 for seen, wanted in zip(colour, colours.T, strict=True))
        shown = inside & front & (depth < known)
        return (weights * shown * (cost - jnp.minimum(gap, MOST_COST))).sum() / weights.sum()

    return jax.vmap(gain)(yaw, place)
