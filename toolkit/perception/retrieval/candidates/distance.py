"""Distances between observation vectors, in radians."""

from __future__ import annotations

import numpy as np

from toolkit.types import Float


def paper_distance(observations: Float, reference: Float) -> Float:
    """Eq. obs_pose_distance as printed: norm of the differences of arctan(y / x) and arccos(z).

    arctan(y / x) is the same for opposite azimuths, so views from opposite sides of an object look close; see
    `geodesic_distance` for what the text describes.

    Args:
        observations: (R, 3) unit vectors.
        reference: (3,) unit vector.

    Returns:
        (R,) radians.
    """

    def angles(vectors: Float) -> Float:
        x, y, z = vectors[..., 0], vectors[..., 1], np.clip(vectors[..., 2], -1, 1)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            azimuth = np.arctan(y / x)
        # On the vertical axis 0 / 0: the azimuth is undefined there, and any fixed value will do.
        return np.stack([np.nan_to_num(azimuth), np.arccos(z)], axis=-1)

    return np.asarray(np.linalg.norm(angles(observations) - angles(reference), axis=-1))


def geodesic_distance(observations: Float, reference: Float) -> Float:
    """Angle between (R, 3) unit vectors and a (3,) unit vector: (R,) radians in [0, pi]."""
    cross = np.linalg.norm(np.cross(observations, reference), axis=-1)
    return np.asarray(np.arctan2(cross, observations @ reference))
