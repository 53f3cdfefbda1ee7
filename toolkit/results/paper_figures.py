"""The paper's own figures (Tables I and II), which are shown beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

MULTI_VIEW = {60: (0.17, 0.17), 180: (0.25, 0.18)}
SINGLE_VIEW = {60: (7.21, 2.24), 180: (153.67, 13.10)}
"""Table I: rotation range (deg) -> median rotation (deg) and translation (cm) error."""

ONE_STEP_COMPLETION: dict[Any, float] = {"all": 0.567, 1: 0.10}
MULTI_STEP_COMPLETION: dict[Any, float] = {"all": 0.640}
"""Table II: views -> share of scenes completed by the whole system."""


def paper_medians(settings: Mapping[str, Any]) -> tuple[float, float] | None:
    """Table I's medians (deg, cm) for a cell that sweeps views and rotation range as the paper does, else None."""
    views, limit = settings.get("pipeline.views"), settings.get("dataset.rotation_deg")
    table = SINGLE_VIEW if views == 1 else MULTI_VIEW if views == "all" else {}
    return next((medians for key, medians in table.items() if key == limit), None)


def paper_completion(settings: Mapping[str, Any]) -> float | None:
    """Table II's completion, 0..1, for a cell that sweeps rounds and views as the paper does, else None."""
    rounds, views = settings.get("rearrange.rounds"), settings.get("pipeline.views")
    if rounds is None or views not in ("all", 1):
        return None
    return (ONE_STEP_COMPLETION if rounds == 1 else MULTI_STEP_COMPLETION).get(views)
