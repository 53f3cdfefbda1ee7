"""Failure attribution: the truth in the place of one stage at a time, and what each stage costs."""

from __future__ import annotations

from typing import Any

from toolkit.errors import ToolkitError
from toolkit.harness.experiment import CellSpec, Experiment
from toolkit.results.comparisons import ALL_TRUE, AS_IT_IS

_TRUTHS: dict[str, dict[str, Any]] = {
    "true masks in the frames": {"pipeline.segmenter": "oracle"},
    "true masks in the goal": {"pipeline.goal_segmenter": "oracle"},
    "true association": {"pipeline.associator": "oracle"},
    "true retrieval": {"pipeline.assignment": "truth"},
}
"""Cell -> what it sets."""

_EXPLAINED = ("true masks in the goal", "true retrieval")


def attribution(experiment: Experiment) -> Experiment:
    """The experiment as it is, with the truth in one stage's place at a time, and with all truths at once.

    What is still lost with all of them is lost in matching, PnP and refinement. A stage that has the truth already, and
    so costs nothing, is left out.

    Raises:
        ToolkitError: the experiment has several cells or a sweep, or none of its stages can be given the truth.
    """
    if experiment.cells or experiment.sweep:
        several = ", ".join(experiment.sweep) or ", ".join(cell.name for cell in experiment.cells)
        raise ToolkitError(f"attribution takes one setting, but '{experiment.name}' has several: {several}")
    truths = {cell: changes for cell, changes in _TRUTHS.items() if not _has(experiment.pipeline, changes)}
    if _name(experiment.pipeline.get("explainer")) not in (None, "none"):
        # An explainer decides on masks and instances, so it stands back where one of them is the truth.
        truths |= {cell: {**truths[cell], "pipeline.explainer": "none"} for cell in _EXPLAINED if cell in truths}
    if not truths:
        raise ToolkitError(f"every stage of '{experiment.name}' has the truth already; there is nothing to attribute")
    everything = {path: value for changes in truths.values() for path, value in changes.items()}
    cells = {AS_IT_IS: {}, **truths, **({ALL_TRUE: everything} if len(truths) > 1 else {})}
    specs = tuple(CellSpec(name=name, set=changes) for name, changes in cells.items())
    return experiment.model_copy(
        update={
            "name": f"{experiment.name}-attribution",
            "title": f"What each stage of '{experiment.title or experiment.name}' costs",
            "description": "The truth in the place of one stage at a time.",
            "cells": specs,
            "reference": AS_IT_IS,
        }
    )


def _has(pipeline: dict[str, Any], changes: dict[str, Any]) -> bool:
    """Say whether a pipeline has these values already."""
    values = {path.removeprefix("pipeline."): value for path, value in changes.items()}
    return all(_name(pipeline.get(slot)) == value for slot, value in values.items())


def _name(choice: Any) -> Any:
    return choice.get("name") if isinstance(choice, dict) else choice
