"""template: an executor. A simulator whose gripper lets go a little beside the place it was told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from toolkit.data.tabletop import TabletopScene
from toolkit.rearrangement.executors.kinematic import Kinematic, KinematicConfig
from toolkit.rearrangement.moves import Outcome, PickPlace
from toolkit.types import Frame


class TemplateConfig(KinematicConfig):
    """Settings of `template`."""

    slip_mm: float = Field(2.0, ge=0, description="Standard deviation of where an object is put, an axis.")


class Template(Kinematic[TemplateConfig]):
    """The kinematic simulator with placement errors; those of one task are the same every time."""

    name = "template"

    def begin(self, task: TabletopScene) -> Frame:
        """Take up a task and return its goal image."""
        self._rng = np.random.default_rng(task.number)
        return super().begin(task)

    def pick_place(self, request: PickPlace) -> Outcome:
        """Put the object down beside its place, by up to three standard deviations."""
        T = request.T_place_pick.copy()
        T[:2, 3] += np.clip(self._rng.normal(0, 1, 2), -3, 3) * self.config.slip_mm / 1000
        return super().pick_place(replace(request, T_place_pick=T))
