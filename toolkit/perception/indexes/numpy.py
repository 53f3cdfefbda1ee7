"""Exact inner-product search in NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.perception.stages import Index
from toolkit.registry import Plugin
from toolkit.types import Float


class NumpyIndex(Plugin, Index):
    """Exact inner-product search by one matrix product and a stable sort; equal scores come in row order."""

    stage = "index"
    name = "numpy"

    _vectors: Float | None = None

    def build(self, vectors: Float) -> None:
        """Take (N, d) float32 vectors as the database."""
        self._vectors = np.ascontiguousarray(vectors, np.float32)

    def search(self, queries: Float, k: int) -> tuple[Float, NDArray[np.int64]]:
        """Return (Q, k') scores in falling order and (Q, k') rows; raises ToolkitError before `build`."""
        if self._vectors is None:
            raise ToolkitError("the index was searched before it was built")
        scores = np.asarray(queries, np.float32) @ self._vectors.T
        rows = np.argsort(-scores, axis=1, kind="stable")[:, :k]
        return np.take_along_axis(scores, rows, axis=1), rows
