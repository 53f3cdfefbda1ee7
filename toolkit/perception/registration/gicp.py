"""Camera poses corrected by the surfaces that depth shows, where these overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pydantic import Field

from toolkit.perception.registration.shared.stated import StatedConfig
from toolkit.perception.registration.surfaces.align import find_surface, import_small_gicp, link, reconcile
from toolkit.perception.stages import Registration
from toolkit.registry import Plugin
from toolkit.types import Frame


class GicpConfig(StatedConfig):
    """Settings of the `gicp` registration."""

    voxel_mm: float = Field(
        10.0, gt=0, description="Side of the cubes of which one point each is aligned, in millimetres."
    )
    reach_mm: float = Field(
        10.0, gt=0, description="Points further apart than this are not taken for the same place, in millimetres."
    )


class Gicp(Plugin[GicpConfig], Registration):
    """Generalized ICP between every two frames, then all poses together; needs no texture.

    ICP takes depth on both sides, and the goal is one RGB image. IFOR, whose goal has depth, ends in ICP between goal
    and current scene; here ICP can only bring the current frames together, and the goal's pose stays as stated.

    `register` raises ToolkitError where a frame has no depth.
    """

    stage = "registration"
    name = "gicp"

    def check_ready(self) -> None:
        """Import small_gicp, so that a missing package stops the command before any work."""
        import_small_gicp()

    def register(self, frames: Sequence[Frame]) -> list[Frame]:
        stated = [frame.camera.T_world_camera for frame in frames]
        surfaces = [find_surface(frame, self.config.voxel_mm / 1e3) for frame in frames]
        links = link(surfaces, stated, self.config.reach_mm / 1e3)
        poses = reconcile(stated, links, self.config.sigma)
        return [replace(f, camera=replace(f.camera, T_world_camera=T)) for f, T in zip(frames, poses, strict=True)]

    def locate(self, goal: Frame, frames: Sequence[Frame]) -> Frame:
        return goal
