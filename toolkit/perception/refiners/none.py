"""No refinement: the answer of PnP stands."""

from __future__ import annotations

from toolkit.perception.fusion import RefineTask
from toolkit.perception.stages import Refiner
from toolkit.registry import Plugin


class Unrefined(Plugin, Refiner):
    """Leaves the motion as PnP found it, as the paper does."""

    stage = "refiner"
    name = "none"

    def refine(self, task: RefineTask) -> None:
        return None

    def verify(self, task: RefineTask) -> None:
        return None
