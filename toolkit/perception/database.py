"""The hierarchical database H of the current scene (Sec. Method A): regions by instance with S, G, P and E."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.types import Camera, Float, Frame, Region, Segment

_SCHEMA = 2


@dataclass(frozen=True, eq=False)
class Database:
    """All object regions of the current scene, as parallel rows.

    Attributes:
        frames: the frames the regions were seen in.
        regions: R regions (S, P and E of the paper).
        instances: (R,) int64 object instance of every region.
        descriptors: (R, d) float32 unit rows (G of the paper).
        dropped: segments that gave no region (too few measured points), counted so that nothing vanishes silently.
        T_world_level: (4, 4) from the table's own frame into this one's (`toolkit.perception.level`).
        in_level: the same database in the table's own frame; None where this one is in it.
    """

    frames: tuple[Frame, ...]
    regions: tuple[Region, ...]
    instances: NDArray[np.int64]
    descriptors: Float
    dropped: int = 0
    T_world_level: Float = field(default_factory=lambda: np.eye(4))
    in_level: Database | None = None

    def __post_init__(self) -> None:
        r = len(self.regions)
        if self.instances.shape != (r,) or self.descriptors.shape[:1] != (r,):
            raise ToolkitError(f"a database of {r} regions needs as many instance ids and descriptors")

    def __len__(self) -> int:
        return len(self.regions)

    @property
    def level(self) -> Database:
        """The database as stages see it: in the table's own frame."""
        return self if self.in_level is None else self.in_level

    def placed(self, T_world_level: Float) -> Database:
        """The database in the user's world, this one kept as its `level`.

        Args:
            T_world_level: (4, 4) from this database's frame into the world.
        """
        return replace(
            self,
            frames=tuple(frame.moved(T_world_level) for frame in self.frames),
            regions=tuple(region.moved(T_world_level) for region in self.regions),
            T_world_level=T_world_level,
            in_level=self,
        )

    @property
    def observations(self) -> Float:
        """(R, 3) observation vectors (Eq. obs_pose)."""
        return np.array([region.observation for region in self.regions]).reshape(-1, 3)

    def frame_of(self, row: int) -> Frame:
        """The frame that region `row` was seen in."""
        index = self.regions[row].frame_index
        return next(frame for frame in self.frames if frame.index == index)

    def instance(self, instance: int) -> list[int]:
        """Rows of one object instance: H[u] of the paper."""
        return np.flatnonzero(self.instances == instance).tolist()

    def joined(self, groups: Sequence[Sequence[int]]) -> Database:
        """The same regions, the instances of each group taken for the first one of it; no other id changes."""
        instances = self.instances.copy()
        for first, *others in groups:
            instances[np.isin(instances, others)] = first
        in_level = None if self.in_level is None else self.in_level.joined(groups)
        return replace(self, instances=instances, in_level=in_level)

    def save(self, path: Path) -> None:
        """Write everything to one .npz file, without pickle."""
        kept = self.level
        starts = np.cumsum([0, *(len(region.points) for region in kept.regions)])
        np.savez_compressed(
            path,
            schema=np.array(_SCHEMA),
            frame_index=np.array([frame.index for frame in kept.frames]),
            rgb=np.stack([frame.rgb for frame in kept.frames]),
            depth=np.stack([_depth(frame) for frame in kept.frames]),
            K=np.stack([frame.camera.K for frame in kept.frames]),
            T_world_camera=np.stack([frame.camera.T_world_camera for frame in kept.frames]),
            region_frame=np.array([region.frame_index for region in kept.regions], np.int64),
            masks=np.stack([np.packbits(region.segment.mask) for region in kept.regions])
            if kept.regions
            else np.zeros((0, 0), np.uint8),
            scores=np.array([region.segment.score for region in kept.regions]),
            starts=starts,
            points=np.concatenate([np.zeros((0, 3), np.float32), *(region.points for region in kept.regions)]),
            pixels=np.concatenate([np.zeros((0, 2), np.int32), *(region.pixels for region in kept.regions)]),
            observations=kept.observations,
            instances=kept.instances,
            T_world_level=self.T_world_level,
            descriptors=kept.descriptors,
            meta=np.array(json.dumps({"dropped": kept.dropped})),
        )

    @classmethod
    def load(cls, path: Path) -> Database:
        """Read what `save` wrote.

        Raises:
            ToolkitError: the file is absent, damaged, or of another schema.
        """
        try:
            with np.load(path, allow_pickle=False) as archive:
                data = {name: archive[name] for name in archive.files}
        except (OSError, ValueError, zipfile.BadZipFile) as error:
            raise ToolkitError(f"database '{path}' cannot be read: {error}") from error
        if int(data.get("schema", np.array(-1))) != _SCHEMA:
            raise ToolkitError(f"database '{path}' is not of schema {_SCHEMA}; build it again")
        height, width = data["rgb"].shape[1:3]
        frames = tuple(
            Frame(int(i), rgb, Camera(K, T, width, height), depth)
            for i, rgb, depth, K, T in zip(
                data["frame_index"], data["rgb"], data["depth"], data["K"], data["T_world_camera"], strict=True
            )
        )
        regions = tuple(
            Region(
                int(data["region_frame"][r]),
                Segment(
                    np.unpackbits(data["masks"][r], count=height * width).astype(bool).reshape(height, width),
                    float(data["scores"][r]),
                ),
                data["points"][data["starts"][r] : data["starts"][r + 1]],
                data["pixels"][data["starts"][r] : data["starts"][r + 1]],
                data["observations"][r],
            )
            for r in range(len(data["region_frame"]))
        )
        dropped = int(json.loads(str(data["meta"]))["dropped"])
        level = cls(frames, regions, data["instances"], data["descriptors"], dropped)
        T = data["T_world_level"]
        return level if np.array_equal(T, np.eye(4)) else level.placed(T)


def _depth(frame: Frame) -> Float:
    if frame.depth is None:
        raise ToolkitError(f"frame {frame.index} of the database has no depth")
    return frame.depth
