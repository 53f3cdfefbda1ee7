"""Inner-product search by FAISS."""

from __future__ import annotations

from typing import Any

import faiss
import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.perception.stages import Index
from toolkit.registry import Plugin
from toolkit.types import Float


class FaissIndex(Plugin, Index):
    """FAISS IndexFlatIP (Johnson et al., Billion-scale similarity search with GPUs, 2019): exact."""

    stage = "index"
    name = "faiss"

    _index: Any = None

    def build(self, vectors: Float) -> None:
        """Take (N, d) float32 vectors as the database."""
        self._index = faiss.IndexFlatIP(vectors.shape[1])
        self._index.add(np.ascontiguousarray(vectors, np.float32))

    def search(self, queries: Float, k: int) -> tuple[Float, NDArray[np.int64]]:
        """Return (Q, k') scores in falling order and (Q, k') rows; raises ToolkitError before `build`."""
        if self._index is None:
            raise ToolkitError("the index was searched before it was built")
        scores, rows = self._index.search(np.ascontiguousarray(queries, np.float32), min(k, self._index.ntotal))
        # FAISS leaves the order of equal scores open.
        order = np.lexsort((rows, -scores), axis=1)
        return np.take_along_axis(scores, order, axis=1), np.take_along_axis(rows, order, axis=1)
