"""A PyBullet client as an object: calls need no client number, and the answers have named fields."""

from __future__ import annotations

import importlib.util
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from toolkit.geometry import make_transform
from toolkit.sim.bullet import pybullet, silence
from toolkit.types import Float

BASE = -1
"""PyBullet's number for the link that a body starts from."""

EVERYTHING = -1
"""PyBullet's mask of all collision groups."""

_RAY_TOP_M, _RAY_BELOW_M = 2.0, 0.003


class Contact(NamedTuple):
    """Where a body touches another, or nearly does.

    Attributes:
        link: of the body that was asked about.
        other: the other body; the same one where two of its links meet.
        other_link: of the other body.
        distance: metres; negative where they cut into each other.
        force: along the contact's normal, newtons.
    """

    link: int
    other: int
    other_link: int
    distance: float
    force: float


class Joint(NamedTuple):
    """A joint of a body, and the link it carries, which has the same number.

    Attributes:
        name: of the joint.
        link: name of the link.
        parent: number of the link it hangs on.
        lower: smallest angle (radians) or way (metres).
        upper: largest; not above `lower` where there is no limit.
        axis: (3,) unit vector in the joint's own frame.
    """

    name: str
    link: str
    parent: int
    lower: float
    upper: float
    axis: Float


class LinkState(NamedTuple):
    """Where a link is: places (metres) and quaternions (x, y, z, w) in world coordinates."""

    mass_place: Sequence[float]
    mass_turn: Sequence[float]
    place: Sequence[float]
    turn: Sequence[float]

    @property
    def T_world_link(self) -> Float:
        """(4, 4) pose of its frame, as the URDF has it."""
        return _matrix(self.place, self.turn)

    @property
    def T_world_mass(self) -> Float:
        """(4, 4) pose of its inertial frame, which lies at its centre of mass."""
        return _matrix(self.mass_place, self.mass_turn)


class Client:
    """A PyBullet client of its own; close it after use.

    What has no method here is called by PyBullet's name: `client.setGravity(0, 0, -9.81)`.
    """

    def __init__(self) -> None:
        self._number: int = pybullet.connect(pybullet.DIRECT)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        """PyBullet's function of that name, for this client."""
        return partial(getattr(pybullet, name), physicsClientId=self._number)

    def close(self) -> None:
        """Disconnect; what was in it is gone."""
        with silence():
            self.disconnect()

    def load_egl(self) -> bool:
        """Load PyBullet's EGL plug-in; say whether that worked."""
        spec = importlib.util.find_spec("eglRenderer")
        if spec is None or spec.origin is None:
            return False
        with silence():
            return self.loadPlugin(spec.origin, "_eglRendererPlugin") >= 0

    def add_plane(self) -> int:
        """Add a fixed plane at z = 0; returns its body."""
        return int(self.createMultiBody(0, self.createCollisionShape(pybullet.GEOM_PLANE)))

    def place(self, body: int, T_world_body: Float) -> None:
        """Put a body at a (4, 4) pose of its inertial frame, at once."""
        self.resetBasePositionAndOrientation(body, T_world_body[:3, 3].tolist(), quaternion(T_world_body))

    def pose(self, body: int) -> Float:
        """(4, 4) pose of a body's inertial frame."""
        return _matrix(*self.getBasePositionAndOrientation(body))

    def box(self, body: int) -> tuple[Float, Float]:
        """(3,) smallest and (3,) largest corner of a body's box along the world's axes."""
        low, high = self.getAABB(body)
        return np.array(low), np.array(high)

    def joints(self, body: int) -> list[Joint]:
        """All joints of a body, by number."""
        infos = [self.getJointInfo(body, number) for number in range(self.getNumJoints(body))]
        return [
            Joint(info[1].decode(), info[12].decode(), info[16], info[8], info[9], np.array(info[13])) for info in infos
        ]

    def angles(self, body: int, joints: Sequence[int]) -> Float:
        """(J,) where these joints of a body are, radians or metres."""
        return np.array([state[0] for state in self.getJointStates(body, joints)])

    def link(self, body: int, link: int) -> LinkState:
        """Where a link of a body is, with all joints as they are now."""
        state = self.getLinkState(body, link, computeForwardKinematics=1)
        return LinkState(state[0], state[1], state[4], state[5])

    def ignore(self, body: int, other: int, link: int = BASE) -> None:
        """From now on a link of a body has no contact with the base of another."""
        self.setCollisionFilterPair(body, other, link, BASE, 0)

    def contacts(self, body: int, other: int | None = None, link: int | None = None) -> list[Contact]:
        """The contacts of a body when last looked for; only with another body, or only those of one of its links."""
        chosen = {"bodyB": other, "linkIndexA": link}
        found = self.getContactPoints(body, **{key: value for key, value in chosen.items() if value is not None})
        return [_contact(body, contact) for contact in found]

    def closest(self, body: int, other: int, within: float) -> list[Contact]:
        """Where two bodies are nearest to each other; empty where they are more than `within` metres apart."""
        return [_contact(body, contact) for contact in self.getClosestPoints(body, other, within)]

    def under(self, points: Float, bodies: Sequence[int], groups: int = EVERYTHING) -> int | None:
        """The position in `bodies` of what vertical rays through most of (N, 3) points meet first.

        Rays end 3 mm below the points, and meet these collision groups only. None where they meet none of the bodies.
        """
        above = np.column_stack([points[:, :2], np.full(len(points), _RAY_TOP_M)])
        below = points - np.array([0, 0, _RAY_BELOW_M])
        hits = self.rayTestBatch(above.tolist(), below.tolist(), collisionFilterMask=groups)
        counts = Counter(bodies.index(hit[0]) for hit in hits if hit[0] in bodies)
        return min(counts, key=lambda number: (-counts[number], number), default=None)


def quaternion(T: Float) -> list[float]:
    """(x, y, z, w) of the rotation of a (4, 4) pose."""
    return Rotation.from_matrix(T[:3, :3]).as_quat().tolist()


def _matrix(place: Sequence[float], turn: Sequence[float]) -> Float:
    return make_transform(Rotation.from_quat(turn).as_matrix(), np.array(place))


def _contact(body: int, found: Any) -> Contact:
    """As seen from `body`, whichever of the two PyBullet names first."""
    _, first, second, link, other_link, *_, distance, force = found[:10]
    if first == body:
        return Contact(link, second, other_link, distance, force)
    return Contact(other_link, first, link, distance, force)
