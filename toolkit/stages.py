"""Every stage of both wings: singular stage name -> Registry, in pipeline order. Third parties start here.

A stage never knows which neighbour it has; its Protocol says what it is given and what it answers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from toolkit.errors import ToolkitError, suggest
from toolkit.perception.stages import (
    ASSOCIATORS,
    DESCRIPTORS,
    EXPLAINERS,
    INDEXES,
    MATCHERS,
    PNP,
    REFINERS,
    REGISTRATIONS,
    RETRIEVERS,
    SEGMENTERS,
    Adaptation,
    AdaptiveDescriptor,
    Associator,
    Descriptor,
    Explainer,
    Index,
    Matcher,
    PnP,
    Refiner,
    Registration,
    Retriever,
    Segmenter,
    Traversal,
)
from toolkit.rearrangement.stages import (
    EXECUTORS,
    GRASPERS,
    MOTION_PLANNERS,
    PLANNERS,
    Executor,
    Grasper,
    MotionPlanner,
    Planner,
    Schedule,
)
from toolkit.registry import Plugin, Registry

__all__ = [
    "ASSOCIATORS",
    "DESCRIPTORS",
    "EXECUTORS",
    "EXPLAINERS",
    "GRASPERS",
    "INDEXES",
    "MATCHERS",
    "MOTION_PLANNERS",
    "PLANNERS",
    "PNP",
    "REFINERS",
    "REGISTRATIONS",
    "REGISTRIES",
    "RETRIEVERS",
    "SEGMENTERS",
    "Adaptation",
    "AdaptiveDescriptor",
    "Associator",
    "Descriptor",
    "Executor",
    "Explainer",
    "Grasper",
    "Index",
    "Matcher",
    "MotionPlanner",
    "Planner",
    "PnP",
    "Refiner",
    "Registration",
    "Retriever",
    "Schedule",
    "Segmenter",
    "Traversal",
    "register_module",
    "registry_of",
]

REGISTRIES: dict[str, Registry[Any]] = {
    registry.stage: registry
    for registry in (
        REGISTRATIONS,
        SEGMENTERS,
        ASSOCIATORS,
        EXPLAINERS,
        DESCRIPTORS,
        INDEXES,
        RETRIEVERS,
        MATCHERS,
        PNP,
        REFINERS,
        PLANNERS,
        GRASPERS,
        MOTION_PLANNERS,
        EXECUTORS,
    )
}
"""Singular stage name -> registry, in pipeline order."""


def registry_of(stage: str) -> Registry[Any]:
    """The registry of a stage.

    Raises:
        ToolkitError: there is no such stage; the nearest is offered.
    """
    if stage not in REGISTRIES:
        raise ToolkitError(f"unknown stage '{stage}'{suggest(stage, list(REGISTRIES))}")
    return REGISTRIES[stage]


def register_module(module: Any, origin: str, registries: Mapping[str, Registry[Any]] = REGISTRIES) -> int:
    """Register every plugin class of a module that defines `name` and a `stage` of `registries`; returns how many."""
    count = 0
    for value in vars(module).values():
        is_plugin = isinstance(value, type) and issubclass(value, Plugin) and value.__module__ == module.__name__
        if is_plugin and getattr(value, "stage", None) in registries:
            registries[value.stage].register(value, origin)
            count += 1
    return count
