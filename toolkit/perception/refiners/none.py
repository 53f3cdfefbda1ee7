"""No refinement: the answer of PnP stands."""

from __future__ import annotations

from toolkit.perception.fusion import RefineTask
from toolkit.registry import Plugin


class Unrefined(Plugin):
    """Leaves the motion as PnP found it, as the paper does."""

    stage = "refiner"
    name = "none"

    def refine(self, task: RefineTask) -> None:
        """See Refiner."""

    def verify(self, task: RefineTask) -> None:
        """See Refiner."""
