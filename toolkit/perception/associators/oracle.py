"""True object identities."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.perception.regions import true_owner
from toolkit.perception.stages import Associator
from toolkit.registry import Plugin
from toolkit.types import Frame, Region


class OracleAssociator(Plugin, Associator):
    """Gives every region the true object its mask covers most of; works with any segmenter."""

    stage = "associator"
    name = "oracle"

    def associate(self, regions: Sequence[Region], frames: Sequence[Frame]) -> NDArray[np.int64]:
        """Return (R,) instance ids; raises ToolkitError where a frame has no true masks."""
        masks = {frame.index: frame.true_masks for frame in frames}
        owners: list[int] = []
        for region in regions:
            truth = masks[region.frame_index]
            if truth is None:
                raise ToolkitError(f"the oracle associator needs true masks, and frame {region.frame_index} has none")
            x, y = region.pixels.T
            owners.append(true_owner(truth, (y, x)))
        # Regions on no object at all share one instance of their own, so that they stay in every count.
        return np.unique(owners, return_inverse=True)[1].astype(np.int64)
