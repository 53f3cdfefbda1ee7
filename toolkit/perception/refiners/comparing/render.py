"""Scores poses by rendering the fused model into the goal: silhouette and colour, all hypotheses in one batch (JAX)."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from toolkit.perception.refiners.comparing.cloud import FACING_AWAY

GRID = 48
"""Side of the grid that the goal's object is compared on."""

_TOLERANCE_M = 0.012
"""A point this far behind the nearest surface of its cell is hidden."""

_BLUR_CELLS = 5
_NOISE = 4.0


class GoalGrid(NamedTuple):
    """The goal image around one object, resampled to GRID x GRID cells.

    Attributes:
        color: opponent colours.
        mask: 1 where the object is.
        hidden: 1 where another object may hide it.
        scale: cells for each pixel.
        origin: pixel of the corner of the first cell.
    """

    color: Float[Array, "G G 3"]
    mask: Float[Array, "G G"]
    hidden: Float[Array, "G G"]
    scale: Float[Array, ""]
    origin: Float[Array, " 2"]


class Score(NamedTuple):
    """How well a rendered pose agrees with the goal.

    Attributes:
        total: iou + known * (correlation - color), higher is better.
        iou: overlap of silhouettes, not counting what another object may hide.
        known: 0..1, share of the overlap that shows a side that some view has seen.
        correlation: -1..1, of locally normalised colours there; 0 where there is no texture.
        color: mean difference of colours there, as a part of full contrast.
    """

    total: Float[Array, "*batch"]
    iou: Float[Array, "*batch"]
    known: Float[Array, "*batch"]
    correlation: Float[Array, "*batch"]
    color: Float[Array, "*batch"]


@jax.jit
def score_poses(
    points: Float[Array, "N 3"],
    normals: Float[Array, "N 3"],
    colors: Float[Array, "N 3"],
    valid: Bool[Array, " N"],
    known: Bool[Array, " N"],
    K: Float[Array, "3 3"],
    poses: Float[Array, "B 4 4"],
    shade: Float[Array, "B N"],
    goal: GoalGrid,
) -> Score:
    """Score poses T_camera_model of points (metres) with outward normals and opponent colours.

    Only `valid` points count; `shade` is the factor of their brightness in every pose. What is not `known`, or seen
    from behind, belongs to the silhouette but has no colour.
    """
    return jax.vmap(
        lambda pose, factor: _score(points, normals, colors * factor[:, None], valid, known, K, pose, goal)
    )(poses, shade)


def _score(
    points: Float[Array, "N 3"],
    normals: Float[Array, "N 3"],
    colors: Float[Array, "N 3"],
    valid: Bool[Array, " N"],
    known: Bool[Array, " N"],
    K: Float[Array, "3 3"],
    pose: Float[Array, "4 4"],
    goal: GoalGrid,
) -> Score:
    camera = points @ pose[:3, :3].T + pose[:3, 3]
    z = jnp.maximum(camera[:, 2], 1e-3)
    pixels = camera[:, :2] / z[:, None] * jnp.array([K[0, 0], K[1, 1]]) + K[:2, 2]
    cell = jnp.floor((pixels - goal.origin) * goal.scale).astype(jnp.int32)
    inside = valid & (cell >= 0).all(axis=1) & (cell < GRID).all(axis=1)
    outside = (valid & ~inside).sum() / jnp.maximum(valid.sum(), 1)
    index = jnp.where(inside, cell[:, 1] * GRID + cell[:, 0], GRID * GRID)
    depth = jnp.full(GRID * GRID + 1, 1e3).at[index].min(z)[:-1].reshape(GRID, GRID)
    nearest = -_most(-depth)
    seen = inside & (z < jnp.append(nearest.ravel(), 0.0)[index] + _TOLERANCE_M)
    away = ((normals @ pose[:3, :3].T) * camera).sum(axis=1) / jnp.linalg.norm(camera, axis=1)
    front = seen & known & (away < -FACING_AWAY)
    layers = jnp.concatenate([seen[:, None], front[:, None], colors * front[:, None]], axis=1)
    cells = jnp.zeros((GRID * GRID + 1, 5)).at[index].add(layers)[:-1].reshape(GRID, GRID, 5)
    weight = cells[..., 1]
    color = cells[..., 2:] / jnp.maximum(weight, 1)[..., None]
    painted = (cells[..., 0] > 0).astype(jnp.float32)
    # Closing: points are sparser than cells here and there.
    shape = -_most(-_most(painted))
    free = 1 - goal.hidden
    both = (shape * goal.mask).sum()
    iou = both / jnp.maximum((shape * free).sum() * (1 + outside) + goal.mask.sum() - both, 1)
    overlap = (weight > 0) * goal.mask
    share = overlap.sum() / jnp.maximum((painted * goal.mask).sum(), 1)
    correlation, difference = _agreement(color, goal.color, overlap)
    return Score(iou + share * (correlation - difference), iou, share, correlation, difference)


def _agreement(
    a: Float[Array, "G G 3"], b: Float[Array, "G G 3"], weight: Float[Array, "G G"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Correlation of locally centred colours, and mean difference of the colours, both weighted."""
    count = jnp.maximum(weight.sum(), 1)
    local_a, local_b = _centered(a, weight), _centered(b, weight)
    # Noise in both: where there is no texture, nothing correlates and nothing contradicts.
    floor = _NOISE**2 * count
    correlation = (local_a * local_b).sum() / jnp.sqrt(((local_a**2).sum() + floor) * ((local_b**2).sum() + floor))
    gap = jnp.abs(a - b) * jnp.array([0.5, 1.0, 1.0])
    return correlation, (gap.sum(axis=-1) * weight).sum() / count / 128


def _centered(image: Float[Array, "G G 3"], weight: Float[Array, "G G"]) -> Float[Array, "G G 3"]:
    total, share = _box(image * weight[..., None]), _box(weight[..., None])
    return (image - total / jnp.maximum(share, 1e-6)) * weight[..., None]


def _box(image: Float[Array, "G G C"]) -> Float[Array, "G G C"]:
    size = 2 * _BLUR_CELLS + 1
    rows = jax.lax.reduce_window(image, 0.0, jax.lax.add, (size, 1, 1), (1, 1, 1), "SAME")
    return jax.lax.reduce_window(rows, 0.0, jax.lax.add, (1, size, 1), (1, 1, 1), "SAME")


def _most(image: Float[Array, "G G"]) -> Float[Array, "G G"]:
    return jax.lax.reduce_window(image, -jnp.inf, jax.lax.max, (3, 3), (1, 1), "SAME")
