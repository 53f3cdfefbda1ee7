"""Solid bodies: everything that is there can be touched."""

from __future__ import annotations

import numpy as np
import trimesh

from toolkit.geometry import make_transform
from toolkit.sim.solids import Solids


def test_objects_of_many_pieces_are_whole(tmp_path):
    """PyBullet's list of shapes ends at 16 pieces; every one of these must be there to be touched."""
    pieces = []
    for i in range(40):
        mesh = trimesh.creation.box((0.008, 0.02, 0.02))
        mesh.apply_translation([0.01 * i, 0, 0])
        pieces.append(tmp_path / f"{i}.stl")
        mesh.export(pieces[-1])
    probe = tmp_path / "probe.stl"
    trimesh.creation.box((0.002, 0.002, 0.002)).export(probe)
    solids = Solids([pieces, [probe]])
    for i in range(40):
        solids.place(1, make_transform(np.eye(3), np.array([0.01 * i, 0, 0])))
        assert solids.touching(0, 0.001) == [1]
    assert solids.client.getNumBodies() == 2
    solids.place(1, make_transform(np.eye(3), np.array([0.01 * 40, 0, 0])))
    assert solids.touching(0, 0.001) == []
    solids.close()
