"""Camera poses from depth that overlaps: every two frames' surfaces are aligned, then all poses are found together.

Generalized ICP (Segal et al., RSS 2009) by small_gicp (Koide, JOSS 2024) gives every pair's relative pose and how
exactly its surfaces hold it, which is little along a bare table. How far stated poses are to be believed is a Gaussian
prior; it also holds what depth leaves open, such as a common motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, lift, make_transform
from toolkit.types import Float, Frame

_STEP_PX = 2
_FEWEST = 100
"""Points; fewer are no surface."""

_SETTLED = 1e-4
"""Alignment ends once its steps are smaller than this, radians and metres."""

_ITERATIONS = 3
_ACROSS_M = 0.001
"""How exactly depth is known across a surface."""

_UNIT_VARIANCE = 2e-3
"""Variance across a surface of a pair of points in small_gicp's units, in which it is 2 along it."""

_ALIKE = 100
"""Neighbouring points err alike: so many count as one."""


@dataclass(frozen=True, eq=False)
class Surface:
    """What one frame's depth shows: small_gicp's cloud of thinned points in the camera's frame, and its search tree."""

    cloud: Any
    tree: Any


@dataclass(frozen=True, eq=False)
class Link:
    """Where one camera stands from another's.

    Attributes:
        first: row of the frame whose camera's frame the pose is in.
        second: row of the other frame.
        T_first_second: (4, 4).
        information: (6, 6) of a (turn, shift) of it on the right, 1/rad^2 and 1/m^2.
    """

    first: int
    second: int
    T_first_second: Float
    information: Float


def import_small_gicp() -> Any:
    """The package that aligns.

    Raises:
        ToolkitError: it is not installed.
    """
    try:
        import small_gicp
    except ImportError as error:
        raise ToolkitError(
            "registration 'gicp' needs small-gicp, which is not installed; run: pip install 'rearrange-toolkit[icp]'"
        ) from error
    return small_gicp


def find_surface(frame: Frame, voxel: float) -> Surface | None:
    """The measured surface of a frame, one point per cube of side `voxel`, metres; None where it is hardly any."""
    if frame.depth is None:
        raise ToolkitError(f"frame {frame.index} has no depth, which registration 'gicp' aligns")
    y, x = (part * _STEP_PX for part in np.nonzero(frame.depth[::_STEP_PX, ::_STEP_PX]))
    if len(x) < _FEWEST:
        return None
    pixels = np.stack([x, y], axis=1).astype(np.float64)
    points = lift(frame.camera.K, np.eye(4), pixels, frame.depth[y, x])
    return Surface(*import_small_gicp().preprocess_points(points, downsampling_resolution=voxel))


def link(surfaces: Sequence[Surface | None], stated: Sequence[Float], reach: float) -> list[Link]:
    """Align every two surfaces.

    Args:
        surfaces: N, None for a frame without any.
        stated: N (4, 4) T_world_camera, where alignment starts.
        reach: points further apart than this are not the same place, metres.
    """
    links: list[Link] = []
    for i, j in combinations(range(len(surfaces)), 2):
        a, b = surfaces[i], surfaces[j]
        if a is not None and b is not None:
            start = invert(stated[i]) @ stated[j]
            found = import_small_gicp().align(
                a.cloud,
                b.cloud,
                a.tree,
                start,
                max_correspondence_distance=reach,
                rotation_epsilon=_SETTLED,
                translation_epsilon=_SETTLED,
            )
            information = np.asarray(found.H) * (_UNIT_VARIANCE / _ACROSS_M**2 / _ALIKE)
            links.append(Link(i, j, np.asarray(found.T_target_source), information))
    return links


def reconcile(stated: Sequence[Float], links: Sequence[Link], sigma: Float) -> list[Float]:
    """Poses that agree with the links, and with what was stated as far as those leave it open; by Gauss-Newton.

    Args:
        stated: N (4, 4) T_world_camera.
        links: between them.
        sigma: (6,) expected errors of a stated pose: turn xyz, radians, and shift xyz, metres, in the camera's frame.

    Returns:
        N (4, 4) T_world_camera.
    """
    poses: list[Float] = list(stated)
    prior = np.diag(1 / sigma**2)
    for _ in range(_ITERATIONS):
        H, g = np.zeros((len(poses), 6, len(poses), 6)), np.zeros((len(poses), 6))
        for n, pose in enumerate(poses):
            H[n, :, n] += prior
            g[n] += prior @ _small(invert(stated[n]) @ pose)
        for one in links:
            between = invert(poses[one.first]) @ poses[one.second]
            residual = _small(invert(one.T_first_second) @ between)
            jacobians = ((one.first, -_adjoint(invert(between))), (one.second, np.eye(6)))
            for n, J in jacobians:
                g[n] += J.T @ one.information @ residual
                for m, other in jacobians:
                    H[n, :, m] += J.T @ one.information @ other
        size = 6 * len(poses)
        steps = -np.linalg.solve(H.reshape(size, size), g.ravel()).reshape(-1, 2, 3)
        poses = [
            pose @ make_transform(Rotation.from_rotvec(turn).as_matrix(), shift)
            for pose, (turn, shift) in zip(poses, steps, strict=True)
        ]
    return poses


def _small(T: Float) -> Float:
    """(6,) turn and shift of a small motion."""
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3]])


def _adjoint(T: Float) -> Float:
    """(6, 6) that takes a small (turn, shift) on the right of T to the same on its left."""
    R, (x, y, z) = T[:3, :3], T[:3, 3]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.block([[R, np.zeros((3, 3))], [cross @ R, R]])
