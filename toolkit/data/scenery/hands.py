"""A hand or a gripper that reaches into a picture from its border, over the table and in front of objects.

In its own coordinates its fingertips are at the origin, its arm lies along +x, its palm faces -z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from toolkit.data.procedural import textures
from toolkit.data.procedural.meshes import Rect, Surface, loft, merge
from toolkit.data.scenery import surfaces
from toolkit.data.scenery.props import AWAY, Prop, block, sheet_of
from toolkit.data.visibility import visible_shares
from toolkit.geometry import make_transform, transform_points
from toolkit.types import Camera, Float

_TRIES = 60
_ABOVE_M = 0.02
"""Least distance of a hand from the table."""

_CLEAR_M = 0.01
"""Least distance of a hand from the spheres around the objects."""

_HIDES = 0.5
"""The most that it hides of what is seen of any object."""

_REACH = (0.1, 0.36)
"""How far into the picture the fingertips come, in parts of its size."""


@dataclass(frozen=True, eq=False)
class Look:
    """A camera, and the objects before it: (N, 3) points of each in world coordinates."""

    camera: Camera
    bodies: Sequence[Float]


def draw_hands(share: float, looks: Sequence[Look], rng: np.random.Generator) -> tuple[Prop | None, list[Float]]:
    """A hand or a gripper, and where it is in every picture: (4, 4) hand to world, out of sight in most.

    It touches nothing, and hides at most half of what is seen of any object.

    Args:
        share: of the pictures that it reaches into.
        looks: the pictures.
        rng: the source of chance.
    """
    reached = rng.random(len(looks)) < share
    if not reached.any():
        return None, [AWAY] * len(looks)
    hand = _gripper(rng) if rng.random() < 0.35 else _hand(rng)
    return hand, [_reach_in(hand, look, rng) if r else AWAY for look, r in zip(looks, reached, strict=True)]


def _reach_in(hand: Prop, look: Look, rng: np.random.Generator) -> Float:
    """A pose of a hand that reaches into a picture from its border; AWAY where no try was clear of everything."""
    middles = [points.mean(axis=0) for points in look.bodies]
    radii = [np.linalg.norm(points - middle, axis=1).max() for points, middle in zip(look.bodies, middles, strict=True)]
    seen = visible_shares(look.bodies, look.camera)
    for _ in range(_TRIES):
        T = _reaching(look.camera, rng)
        points = transform_points(T, hand.surface.vertices)
        clear = all(
            np.linalg.norm(points - middle, axis=1).min() > radius + _CLEAR_M
            for middle, radius in zip(middles, radii, strict=True)
        )
        if points[:, 2].min() > _ABOVE_M and clear:
            veiled = visible_shares(look.bodies, look.camera, [points])
            if (veiled >= (1 - _HIDES) * seen).all():
                return T
    return AWAY


def _reaching(camera: Camera, rng: np.random.Generator) -> Float:
    side = int(rng.integers(4))
    inward = rng.uniform(*_REACH)
    across = rng.uniform(0.2, 0.8)
    u, v = ((inward, across), (1 - inward, across), (across, inward), (across, 1 - inward))[side]
    out = np.array([(-1, 0), (1, 0), (0, -1), (0, 1)][side], np.float64)
    pixel = np.array([u * camera.width, v * camera.height, 1.0])
    ray = np.linalg.inv(camera.K) @ pixel
    R, eye = camera.T_world_camera[:3, :3], camera.T_world_camera[:3, 3]
    down = (R @ ray)[2]
    far = -eye[2] / down if down < -0.1 else 1.2
    tip = eye + R @ ray * far * rng.uniform(0.55, 0.95)
    sideways = rng.normal(0, 0.35)
    arm = np.array([*(out + sideways * out[::-1]), rng.uniform(-0.7, 0.1)])
    x = R @ (arm / np.linalg.norm(arm))
    # The palm faces down, as far as the arm's direction lets it.
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    roll = Rotation.from_rotvec(rng.normal(0, 0.4) * x).as_matrix()
    return make_transform(roll @ np.stack([x, y, np.cross(x, y)], axis=1), tip)


def _hand(rng: np.random.Generator) -> Prop:
    tone = np.array([[236, 188, 160], [198, 146, 112], [141, 94, 66], [88, 58, 44]])[int(rng.integers(4))]
    skin = np.clip(tone + rng.normal(0, 10, 3), 20, 250).astype(int)
    flesh = textures.speckled(rng, textures.canvas(128, 128, (int(skin[0]), int(skin[1]), int(skin[2]))), 3.0)
    sleeve = surfaces.checked(rng, 128, 128) if rng.random() < 0.4 else surfaces.laminate(rng, 128, 128)
    sheet, (bare, cloth) = sheet_of([flesh, sleeve], 2, 128)
    size, curl = rng.uniform(0.85, 1.1), rng.uniform(0.1, 0.9)
    parts = [_finger(size, y, curl + rng.normal(0, 0.08), bare) for y in (-0.033, -0.011, 0.011, 0.032)]
    parts.append(_limb(np.array([[0.03, -0.062, -0.03], [0.075, -0.056, -0.018], [0.12, -0.03, 0]]), 0.011, bare))
    x = np.linspace(0.075, 0.18, 8)
    wide = np.interp(x, [0.075, 0.11, 0.18], [0.043, 0.046, 0.03])
    palm = loft(np.stack([x, 0 * x, 0 * x], axis=1), np.stack([wide, np.full(8, 0.014)], axis=1), 3.0, bare)
    cuff = rng.uniform(0.2, 0.34)
    wrist = _limb(np.array([[0.16, 0, 0], [cuff, 0, 0.005], [cuff + 0.05, 0, 0.006]]), 0.028, bare)
    arm = _limb(np.array([[cuff, 0, 0.005], [0.45, 0, 0.01], [0.75, 0, 0.02]]), 0.042, cloth)
    whole = merge([*parts, palm, wrist, arm])
    return Prop(Surface(whole.vertices * size, whole.uv, whole.faces, ()), sheet)


def _finger(size: float, y: float, curl: float, rect: Rect) -> Surface:
    """Three joints that bend towards the palm's side; its tip near the origin."""
    lengths = np.array([0.028, 0.026, 0.034]) * (1 - 4 * abs(y))
    bends = curl * np.array([1.6, 0.9, 0.3])
    steps = -np.stack([lengths * np.cos(bends), 0 * lengths, lengths * np.sin(bends)], axis=1)
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(steps[::-1], axis=0)]) + np.array([0.088, y, 0])
    return _limb(path[::-1], 0.0085 * size, rect)


def _limb(path: Float, radius: float, rect: Rect) -> Surface:
    """A bent tube with round ends: a loft along x, laid along a (P, 3) path that mostly follows x."""
    along = np.linspace(0, 1, 4 * len(path))
    stops = np.linspace(0, 1, len(path))
    centers = np.stack([np.interp(along, stops, column) for column in path.T], axis=1)
    swell = np.sqrt(np.clip(1 - np.maximum(np.abs(2 * along - 1) - 0.75, 0) ** 2 * 16, 0.05, 1))
    return loft(centers, radius * np.stack([swell, swell], axis=1), 2.0, rect, 16)


def _gripper(rng: np.random.Generator) -> Prop:
    """Two fingers on a palm, on a round arm: dark, grey or white."""
    shade = int(rng.choice([40, 70, 150, 215]))
    light = textures.speckled(rng, textures.canvas(128, 128, (shade, shade, shade + 5)), 2.0)
    dark = textures.speckled(rng, textures.canvas(128, 128, (45, 45, 48)), 2.0)
    sheet, (body, rubber) = sheet_of([light, dark], 2, 128)
    gap = rng.uniform(0.02, 0.045)
    fingers = [
        _closed(np.array([0, min(s * gap, s * (gap + 0.02)), -0.011]), np.array([0.06, 0.02, 0.022]), rubber)
        for s in (-1, 1)
    ]
    palm = _closed(np.array([0.055, -0.07, -0.03]), np.array([0.07, 0.14, 0.06]), body)
    x = np.linspace(0.12, 0.75, 12)
    wide = np.where(x < 0.2, 0.04, 0.05 + 0.008 * np.sin(14 * x))
    arm = loft(np.stack([x, 0 * x, 0 * x], axis=1), np.stack([wide, wide], axis=1), 2.0, body, 24)
    return Prop(merge([*fingers, palm, arm]), sheet)


def _closed(low: Float, size: Float, rect: Rect) -> Surface:
    """A box that is seen from below as well."""
    upper = block(low, low + size, [rect] * 5)
    turn = np.diag([1.0, -1.0, -1.0])
    middle = low + size / 2
    lower = block(-size / 2, size / 2, [rect] * 5).moved(turn, middle)
    return merge([upper, lower])
