"""Refinement of what PnP found, without looking for anything else."""

from __future__ import annotations

import numpy as np

from toolkit.perception.refiners.comparing.cloud import Cloud
from toolkit.perception.refiners.comparing.compare import FREE, PLANAR, Search
from toolkit.perception.refiners.render_compare import ImageRefiner


class Photometric(ImageRefiner):
    """Gauss-Newton from PnP's motion on locally normalised intensities and silhouette."""

    name = "photometric"

    def search(self, cloud: Cloud) -> Search:
        c = self.config
        free = PLANAR if c.prior == "planar" else FREE
        return Search(np.zeros((0, 3, 3)), free, c.prior == "resting", 1, c.patches, c.iterations)
