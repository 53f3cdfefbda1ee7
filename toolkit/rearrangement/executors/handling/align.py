"""How far an object has moved from where it was expected, by the points that one picture shows.

Point-to-plane ICP (Chen and Medioni, IVC 1992) between points that are nearest to each other both ways, with Tukey's
loss. What the picture leaves open stays as expected, such as the turn of something round: no step is taken along it
(after Zhang, Kaess and Singh, "On degeneracy of optimization-based state estimation problems", ICRA 2016).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, null_space
from scipy.spatial import ConvexHull, KDTree
from scipy.spatial.transform import Rotation

from toolkit.geometry import invert, make_transform, transform_points
from toolkit.rearrangement.surfaces import normals, thin_out
from toolkit.types import Failure, Float

REACH_M = 0.03
"""What is further from where the object is expected is not taken for it."""

_STARTS_M, _LEAST_REACH_M, _SHRINKS = (0.01, REACH_M), 0.006, 0.9
"""Points are paired over so much at first, and in the end. A near start is not misled by what nobody knew of it."""

_THIN_M, _FEWEST = 0.003, 50
_ALIKE, _APART_M = 0.7, 0.02
"""Cosine between the normals of two points of one surface, at least; and how far apart normals make points that differ
by a radian."""

_SHOWN_EVERY = 5
"""Steps after which it is found out anew which side of the object is seen."""

_SPHERE = 100.0
"""Radius, in distances of the object, of the sphere that hidden points are found with."""

_HELD = 0.02
"""A motion is left open if a smaller part of the squared way on which it takes the points leads off the surface."""

_TINY = 1e-6
"""Points on a line do not move as it turns about itself."""

_STEPS, _SETTLED_M = 60, 5e-5
_ON_IT_M, _FITS = 0.003, 0.7
"""Near the object, so many of the seen points must be this near to it in the end."""

_NOISE_M, _ONE_OF = 0.0005, 100
"""How exact depth is at best, and how many neighbouring points err alike, so that they count as one."""

_OPEN_M = 0.02
"""How far, along what the picture leaves open, the object's points may be from where they were expected: deviation."""


@dataclass(frozen=True, eq=False)
class Aligned:
    """Where an object is.

    Attributes:
        T: (4, 4) its motion from where it was expected.
        covariance: (6, 6) of a further small turn (radians) about the object's middle, and shift (metres).
        fits: share of what is seen near the object that lies on it.
    """

    T: Float
    covariance: Float
    fits: float

    @property
    def sigma_m(self) -> float:
        """Deviation of the shift, metres."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def sigma_deg(self) -> float:
        """Deviation of the turn, degrees."""
        return float(np.degrees(np.sqrt(np.trace(self.covariance[:3, :3]))))


def align(expected: Float, seen: Float, eye: Float) -> Aligned | Failure:
    """Find an object among the points of a picture, near where it is expected.

    Args:
        expected: (N, 3) points of the object, where it is expected.
        seen: (M, 3) points of whatever is seen there, in the same frame.
        eye: (3,) where it is seen from.

    Returns:
        Where it is; a Failure where too little of it is seen, or where what is seen is not the object as it was known.
    """
    near, _ = KDTree(expected).query(seen, distance_upper_bound=REACH_M)
    model, shown = _Surface.of(expected, eye), _Surface.of(seen[np.isfinite(near)], eye)
    if model is None or shown is None:
        return Failure("executor", "too little of the object is seen to say how it lies")
    found = [one for start in _STARTS_M if (one := _Search(model, shown, eye).run(start)) is not None]
    best = max(found, key=lambda one: one.fits, default=None)
    if best is None or best.fits < _FITS:
        return Failure("executor", "what is seen does not look like the object as it was known")
    return best


@dataclass(frozen=True, eq=False)
class _Surface:
    """(N, 3) points, (N, 3) normals, which point to whoever sees them, and a search tree of both together."""

    points: Float
    normals: Float
    tree: Any

    def nearest(self, points: Float, normals: Float) -> NDArray[np.intp]:
        """(M,) which of its points are like (M, 3) points with (M, 3) normals, by place and normal."""
        return np.asarray(self.tree.query(_both(points, normals))[1])

    @classmethod
    def of(cls, points: Float, eye: Float) -> _Surface | None:
        """The surface that points lie on; None where they are hardly any."""
        if len(points) < _FEWEST:
            return None
        points = thin_out(points, _THIN_M)
        return cls._seen(points, normals(points), eye) if len(points) >= _FEWEST else None

    @classmethod
    def _seen(cls, points: Float, normals: Float, eye: Float) -> _Surface:
        away = ((points - eye) * normals).sum(axis=1, keepdims=True) > 0
        normals = np.where(away, -normals, normals)
        return cls(points, normals, KDTree(_both(points, normals)))

    def front(self, eye: Float) -> _Surface:
        """What of it an eye (3,) sees: hidden point removal (Katz, Tal and Basri, SIGGRAPH 2007)."""
        rays = self.points - eye
        lengths = np.linalg.norm(rays, axis=1, keepdims=True)
        flipped = rays * (2 * _SPHERE * lengths.max() / lengths - 1)
        hull = ConvexHull(np.concatenate([flipped, np.zeros((1, 3))])).vertices
        front = np.sort(hull[hull < len(rays)])
        return self._seen(self.points[front], self.normals[front], eye)


def _both(points: Float, normals: Float) -> Float:
    return np.concatenate([points, _APART_M * normals], axis=1)


class _Search:
    """Brings a model to what is shown of it to an eye (3,)."""

    def __init__(self, model: _Surface, shown: _Surface, eye: Float) -> None:
        self._model, self._shown, self._eye = model, shown, eye
        self._middle = (model.points.min(axis=0) + model.points.max(axis=0)) / 2
        size = float(np.linalg.norm(model.points - self._middle, axis=1).mean())
        self._units = np.repeat([1 / size, 1.0], 3)
        """In which a turn is the way that it takes points, metres."""

    def run(self, reach: float) -> Aligned | None:
        """Go on from where the object is expected; None where that comes to no end."""
        pose = np.eye(4)
        front = self._front(pose)
        for turn in range(1, _STEPS):
            J, ways, r = self._pairs(front, pose, reach)
            w = np.maximum(1 - (r / reach) ** 2, 0) ** 2
            if np.count_nonzero(w) < _FEWEST:
                return None
            H, g = J.T @ (w[:, None] * J), J.T @ (w * r)
            W = np.einsum("n,nki,nkj", w, ways, ways)
            values, vectors = eigh(H, W + _TINY * np.trace(W) * np.eye(6))
            left_open = vectors[:, values < _HELD]
            held = null_space(left_open.T) if left_open.size else np.eye(6)
            information = held.T @ H @ held
            step = held @ np.linalg.solve(information, held.T @ g)
            pose = self._moved(pose, step * self._units)
            if reach == _LEAST_REACH_M and np.linalg.norm(step) < _SETTLED_M:
                noise = max(_NOISE_M, float(np.sqrt((w * r**2).sum() / w.sum())))
                known = held @ np.linalg.inv(information) @ held.T * noise**2 * _ONE_OF
                covariance = known + _OPEN_M**2 * (np.eye(6) - held @ held.T)
                return Aligned(pose, covariance * np.outer(self._units, self._units), self._fits(pose))
            reach = max(_LEAST_REACH_M, _SHRINKS * reach)
            if turn % _SHOWN_EVERY == 0:
                front = self._front(pose)
        return None

    def _front(self, T: Float) -> _Surface:
        return self._model.front(transform_points(invert(T), self._eye))

    def _pairs(self, front: _Surface, T: Float, reach: float) -> tuple[Float, Float, Float]:
        """(K, 6) derivatives of (K,) distances from the model's planes, and (K, 3, 6) of its points' ways."""
        seen, toward = self._shown.points, self._shown.normals
        nearest = front.nearest(transform_points(invert(T), seen), toward @ T[:3, :3])
        at, normals = transform_points(T, front.points[nearest]), front.normals[nearest] @ T[:3, :3].T
        back = self._shown.nearest(at, normals)
        paired = np.linalg.norm(seen[back] - seen, axis=1) < 2 * _THIN_M
        paired &= (np.linalg.norm(at - seen, axis=1) < reach) & ((toward * normals).sum(axis=1) > _ALIKE)
        at, normals, seen = at[paired], normals[paired], seen[paired]
        turns = np.cross(np.eye(3), (at - transform_points(T, self._middle))[:, None])
        ways = np.concatenate([np.swapaxes(turns, 1, 2), np.tile(np.eye(3), (len(at), 1, 1))], axis=2) * self._units
        return np.einsum("nk,nki->ni", normals, ways), ways, ((seen - at) * normals).sum(axis=1)

    def _moved(self, T: Float, step: Float) -> Float:
        """T, and after it a turn about the object's middle and a shift, (6,)."""
        R, middle = Rotation.from_rotvec(step[:3]).as_matrix(), transform_points(T, self._middle)
        return make_transform(R, middle - R @ middle + step[3:]) @ T

    def _fits(self, T: Float) -> float:
        distances, _ = KDTree(self._front(T).points).query(transform_points(invert(T), self._shown.points))
        return float((distances < _ON_IT_M).mean())
