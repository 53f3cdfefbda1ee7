"""Contact-GraspNet (Sundermeyer et al., ICRA 2021): a network says where fingers touch, and how the hand comes."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from pydantic import Field
from scipy.spatial import KDTree

from toolkit.models.contact_graspnet import ContactGraspNet, used
from toolkit.rearrangement.grasps.geometry.room import (
    NO_ROOM,
    RoomConfig,
    balance,
    evenly_seen,
    first_with_room,
    grasps_on,
)
from toolkit.rearrangement.grasps.geometry.surface import span
from toolkit.rearrangement.moves import Grasp, GraspRequest
from toolkit.rearrangement.stages import Grasper
from toolkit.registry import Plugin
from toolkit.types import Failure, Float
from toolkit.weights.load import fill, read_tensors
from toolkit.weights.resolve import file_digest, resolve_weights

_TABLE_POINTS_M2 = 26_000
"""Points per square metre of table, as in the clouds the network was trained on."""

_SHADOW_M = 0.01
"""The table this near to a thing, in the plane, is below it."""


class ContactGraspnetConfig(RoomConfig):
    """Settings of `contact_graspnet`."""

    file: Path | None = Field(None, description="Checkpoint; by default the weights `contact_graspnet`.")
    around_m: float = Field(
        0.25, gt=0, description="Points that are nearer than this to the object's middle are given to the network."
    )
    least_score: float = Field(0.2, ge=0, le=1, description="Contacts with a lower score than this are not used.")


class ContactGraspnet(Plugin[ContactGraspnetConfig], Grasper):
    """Contacts, closing lines, approaches and scores by the network; openings measured on the cloud."""

    stage = "grasp"
    name = "contact_graspnet"
    weights = ("contact_graspnet",)

    def check_ready(self) -> None:
        """Load the checkpoint, so that a missing or foreign file stops the command before any work."""
        _ = self._net

    def digests(self) -> dict[str, str]:
        """The checkpoint's digest by file name."""
        return {self._path.name: file_digest(self._path)}

    def grasp(self, request: GraspRequest, seed: int) -> list[Grasp] | Failure:
        seen = evenly_seen(request)
        if isinstance(seen, Failure):
            return seen
        candidates = list(self._candidates(seen, seed))
        if not candidates:
            return Failure("grasp", f"the network gives no contact on the object {self.config.least_score} or more")
        return first_with_room(candidates, seen, self.config) or NO_ROOM

    def _candidates(self, seen: GraspRequest, seed: int) -> Iterator[Grasp]:
        center = seen.points.mean(axis=0)
        for contact, baseline, approach, score in self._contacts(seen, seed):
            a, b = span(seen.points, contact, baseline, self.config.widest_m(seen.gripper))
            worth = float(score) * balance(a, b, center)
            yield from grasps_on(a, b, approach, worth, seen.gripper, self.config)

    @torch.inference_mode()
    def _contacts(self, seen: GraspRequest, seed: int) -> Iterator[tuple[Float, Float, Float, float]]:
        """Contact on the object, line to the opposite one, approach and score."""
        c = self.config
        cloud = on_table(seen, c.around_m, c.table_z_m, np.random.default_rng(seed))
        centered = torch.from_numpy((cloud - cloud.mean(axis=0)).astype(np.float32))
        found = self._net(centered, torch.Generator().manual_seed(seed))
        own = (found.contacts < len(seen.points)) & (found.scores >= c.least_score)
        parts = (found.contacts, found.baselines, found.approaches, found.scores)
        contacts, baselines, approaches, scores = (part[own].numpy().astype(np.float64) for part in parts)
        return zip(cloud[contacts.astype(np.int64)], baselines, approaches, scores, strict=True)

    @cached_property
    def _path(self) -> Path:
        return resolve_weights("contact_graspnet", self.config.file)

    @cached_property
    def _net(self) -> ContactGraspNet:
        net = ContactGraspNet()
        fill(net, used(read_tensors(self._path)), self._path, "Contact-GraspNet as retrained by cgn-pytorch")
        return net


def on_table(seen: GraspRequest, reach: float, table_z: float, rng: np.random.Generator) -> Float:
    """(N, 3) the object's points, then its neighbours' and the table's within reach of its middle, in the plane.

    The table is not seen below what stands on it.
    """
    middle = seen.points[:, :2].mean(axis=0)
    others = seen.others[np.linalg.norm(seen.others[:, :2] - middle, axis=1) < reach]
    things = np.concatenate([seen.points, others])
    table = middle + rng.uniform(-reach, reach, (round(_TABLE_POINTS_M2 * 4 * reach**2), 2))
    free = KDTree(things[:, :2]).query(table)[0] > _SHADOW_M
    table = table[free & (np.linalg.norm(table - middle, axis=1) < reach)]
    return np.concatenate([things, np.column_stack([table, np.full(len(table), table_z)])])
