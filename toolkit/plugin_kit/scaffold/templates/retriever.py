"""template: a retriever. The most similar regions, whatever their instance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.registry import Plugin, PluginConfig
from toolkit.stages import Retriever, Traversal
from toolkit.types import Float


class TemplateConfig(PluginConfig):
    """Settings of `template`."""

    most: int = Field(16, ge=1, description="Largest number of candidates that are tried.")


class Candidates(Traversal):
    """One goal object's candidates, in a fixed order; what is rejected changes nothing about the others."""

    def __init__(self, order: list[int]) -> None:
        self._left = order

    def next(self, n: int) -> list[int]:
        """Return up to n further candidates, best first; empty when none is left."""
        taken, self._left = self._left[:n], self._left[n:]
        return taken

    def reject(self, region: int) -> None:
        """Nothing is skipped."""


class Template(Plugin[TemplateConfig], Retriever):
    """Tries the most similar regions in their order."""

    stage = "retriever"
    name = "template"

    def start(self, ranking: NDArray[np.int64], instances: NDArray[np.int64], observations: Float) -> Candidates:
        """Begin the traversal for one goal object."""
        return Candidates(ranking[: self.config.most].tolist())
