"""template: an index. Exact search, block by block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Index
from toolkit.types import Float


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    block: int = Field(256, ge=1, description="Queries compared at a time.")


class Template(Plugin[TemplateConfig], Index):
    """Exact inner-product search in NumPy, a block of queries at a time."""

    stage = "index"
    name = "template"

    _vectors: Float | None = None

    def build(self, vectors: Float) -> None:
        """Take (N, d) float32 vectors as the database, replacing what was there."""
        self._vectors = np.ascontiguousarray(vectors, np.float32)

    def search(self, queries: Float, k: int) -> tuple[Float, NDArray[np.int64]]:
        """Return (Q, k') float32 scores in falling order and (Q, k') int64 rows, k' = min(k, N)."""
        if self._vectors is None:
            raise ToolkitError("the index was searched before it was built")
        answers = [self._search(self._vectors, block, k) for block in self._blocks(queries)]
        return np.concatenate([a for a, _ in answers]), np.concatenate([b for _, b in answers])

    def _blocks(self, queries: Float) -> list[Float]:
        return [queries[i : i + self.config.block] for i in range(0, len(queries), self.config.block)]

    def _search(self, vectors: Float, queries: Float, k: int) -> tuple[Float, NDArray[np.int64]]:
        scores = np.asarray(queries, np.float32) @ vectors.T
        rows = np.argsort(-scores, axis=1, kind="stable")[:, :k]
        return np.take_along_axis(scores, rows, axis=1), rows
