"""Two-finger grasps from the fused point cloud alone: force closure, width, and room for the gripper."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pydantic import Field

from toolkit.rearrangement.grasps.geometry.room import (
    NO_ROOM,
    RoomConfig,
    balance,
    closing_direction,
    cross,
    evenly_seen,
    first_with_room,
    grasps_on,
)
from toolkit.rearrangement.grasps.geometry.surface import Contacts, antipodal_pairs, wall_pairs
from toolkit.rearrangement.moves import Grasp, GraspRequest
from toolkit.rearrangement.stages import Grasper
from toolkit.rearrangement.surfaces import normals
from toolkit.registry import Plugin
from toolkit.types import Failure, Float, Gripper


class AntipodalConfig(RoomConfig):
    """Settings of `antipodal`."""

    friction: float = Field(0.4, gt=0, description="Coefficient of friction between finger and object.")
    contacts: int = Field(300, ge=1, description="Surface points tried as a first contact.")


class Antipodal(Plugin[AntipodalConfig], Grasper):
    """Opposite surface points in force closure; approaches from above first; clear of table and neighbours.

    What fills the opened gripper, or is wider, is also taken by its walls, as mugs and bowls can be.
    """

    stage = "grasp"
    name = "antipodal"

    def grasp(self, request: GraspRequest, seed: int) -> list[Grasp] | Failure:
        c = self.config
        seen = evenly_seen(request)
        if isinstance(seen, Failure):
            return seen
        rng = np.random.default_rng(seed)
        center, across, widest = seen.points.mean(axis=0), normals(seen.points), c.widest_m(seen.gripper)
        pairs = antipodal_pairs(seen.points, across, widest, c.friction, c.contacts, rng)
        found = first_with_room(self._candidates(pairs, center, seen.gripper), seen, c)
        roomy = [grasp for grasp in found if grasp.spare >= c.spare_m]
        if not found or len(roomy) < len(found):
            pairs_of_walls = wall_pairs(seen.points, across, c.contacts, rng)
            walls = first_with_room(self._candidates(pairs_of_walls, center, seen.gripper), seen, c)
            tight = [grasp for grasp in found if grasp.spare < c.spare_m]
            found = [*roomy, *walls, *tight][: c.keep]
        if not found and not len(pairs):
            return Failure("grasp", f"no two opposite surfaces lie within {100 * widest:.1f} cm of each other")
        return found or NO_ROOM

    def _candidates(self, pairs: Contacts, center: Float, gripper: Gripper) -> Iterator[Grasp]:
        """Grasps on every pair, approaching as steeply as it allows, and from two sides, half and nearly level."""
        for a, b, alignment in zip(pairs.first, pairs.second, pairs.alignment, strict=True):
            x = closing_direction(a, b)
            steepest = np.array([0.0, 0.0, -1.0]) - x * -x[2]
            if np.linalg.norm(steepest) < 0.3:  # one contact above the other: no finger fits below
                continue
            steepest /= np.linalg.norm(steepest)
            worth = float(alignment) * balance(a, b, center)
            aside = cross(x, steepest)
            for tilt in np.radians([0, 35, -35, 75, -75]):
                z = np.cos(tilt) * steepest + np.sin(tilt) * aside
                yield from grasps_on(a, b, z, worth * (0.5 - 0.5 * float(z[2])), gripper, self.config)
