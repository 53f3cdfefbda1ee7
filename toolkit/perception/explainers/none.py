"""The paper's road: the goal segmenter's masks are the goal's objects."""

from __future__ import annotations

from toolkit.perception.explanation import ExplainTask, Explanation
from toolkit.perception.stages import Explainer
from toolkit.registry import Plugin, PluginConfig


class Unexplained(Plugin[PluginConfig], Explainer):
    """Explains nothing: goal objects are what the goal segmenter says, and retrieval says which instance each is."""

    stage = "explainer"
    name = "none"

    def explain(self, task: ExplainTask) -> Explanation | None:
        """Return None."""
        return None
