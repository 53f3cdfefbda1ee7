"""Scores poses by rendering the fused model into the goal: silhouette and colour, a few poses at a time (JAX)."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from toolkit.perception.compiled import Compiled, kept_type
from toolkit.perception.jax_geometry import rotated
from toolkit.perception.refiners.comparing.cloud import FACING_AWAY

GRID = 48
"""Side of the grid that the goal's object is compared on."""

_TOLERANCE_M = 0.012
"""A point this far behind the nearest surface of its cell is hidden."""

_BLUR_CELLS = 5
_NOISE = 4.0

BATCH = 24
"""Poses whose grids fit into a core's cache together; all of them at once take twice the time. One number of them also
makes one program to compile and to load."""


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


@kept_type
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


@Compiled
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
    from behind, belongs to the silhouette but has no colour. B is best always BATCH.
    """
    score = partial(_score, points, normals, colors, valid, known, K, goal)
    return jax.vmap(score)(poses, shade)


def _score(
    points: Float[Array, "N 3"],
    normals: Float[Array, "N 3"],
    colors: Float[Array, "N 3"],
    valid: Bool[Array, " N"],
    known: Bool[Array, " N"],
    K: Float[Array, "3 3"],
    goal: GoalGrid,
    pose: Float[Array, "4 4"],
    shade: Float[Array, " N"],
) -> Score:
    R = pose[:3, :3]
    x, y, z = (turned + shift for turned, shift in zip(rotated(R, points), pose[:3, 3], strict=True))
    ahead = jnp.maximum(z, 1e-3)
    pixels = (x / ahead * K[0, 0] + K[0, 2], y / ahead * K[1, 1] + K[1, 2])
    across, down = (
        jnp.floor((pixel - origin) * goal.scale).astype(jnp.int32)
        for pixel, origin in zip(pixels, goal.origin, strict=True)
    )
    inside = valid & (across >= 0) & (down >= 0) & (across < GRID) & (down < GRID)
    outside = (valid & ~inside).sum() / jnp.maximum(valid.sum(), 1)
    index = jnp.where(inside, down * GRID + across, GRID * GRID)
    depth = jnp.full(GRID * GRID + 1, 1e3).at[index].min(ahead)[:-1].reshape(GRID, GRID)
    nearest = -_most(-depth)
    seen = inside & (ahead < jnp.append(nearest.ravel(), 0.0)[index] + _TOLERANCE_M)
    along = sum(n * p for n, p in zip(rotated(R, normals), (x, y, z), strict=True))
    front = seen & known & (along / jnp.sqrt(x**2 + y**2 + z**2) < -FACING_AWAY)
    light = front * shade
    layers = jnp.stack([seen.astype(light.dtype), front.astype(light.dtype), *(light * c for c in colors.T)], axis=1)
    cells = jnp.zeros((GRID * GRID + 1, 5)).at[index].add(layers)[:-1].T.reshape(5, GRID, GRID)
    weight, color = cells[1], cells[2:] / jnp.maximum(cells[1], 1)
    painted = (cells[0] > 0).astype(jnp.float32)
    # Closing: points are sparser than cells here and there.
    shape = -_most(-_most(painted))
    free = 1 - goal.hidden
    both = (shape * goal.mask).sum()
    iou = both / jnp.maximum((shape * free).sum() * (1 + outside) + goal.mask.sum() - both, 1)
    overlap = (weight > 0) * goal.mask
    share = overlap.sum() / jnp.maximum((painted * goal.mask).sum(), 1)
    correlation, difference = _agreement(color, jnp.moveaxis(goal.color, -1, 0), overlap)
    return Score(iou + share * (correlation - difference), iou, share, correlation, difference)


def _agreement(
    a: Float[Array, "3 G G"], b: Float[Array, "3 G G"], weight: Float[Array, "G G"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Correlation of locally centred colours, and mean difference of the colours, both weighted."""
    count = jnp.maximum(weight.sum(), 1)
    share = jnp.maximum(_box(weight[None]), 1e-6)
    local_a, local_b = ((image - _box(image * weight) / share) * weight for image in (a, b))
    # Noise in both: where there is no texture, nothing correlates and nothing contradicts.
    floor = _NOISE**2 * count
    correlation = (local_a * local_b).sum() / jnp.sqrt(((local_a**2).sum() + floor) * ((local_b**2).sum() + floor))
    gap = jnp.abs(a - b) * jnp.array([0.5, 1.0, 1.0])[:, None, None]
    return correlation, (gap * weight).sum() / count / 128


def _box(image: Float[Array, "C G G"]) -> Float[Array, "C G G"]:
    size = 2 * _BLUR_CELLS + 1
    rows = jax.lax.reduce_window(image, 0.0, jax.lax.add, (1, size, 1), (1, 1, 1), "SAME")
    return jax.lax.reduce_window(rows, 0.0, jax.lax.add, (1, 1, size), (1, 1, 1), "SAME")


def _most(image: Float[Array, "G G"]) -> Float[Array, "G G"]:
    """The largest value of every cell and its eight neighbours."""
    padded = jnp.pad(image, 1, constant_values=-jnp.inf)
    rows = jnp.maximum(jnp.maximum(padded[:-2], padded[1:-1]), padded[2:])
    return jnp.maximum(jnp.maximum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])
