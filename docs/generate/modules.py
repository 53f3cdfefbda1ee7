"""The public modules, by what one comes to them for: pages of the API reference."""

from __future__ import annotations

MODULES: dict[str, tuple[str, ...]] = {
    "Values": ("types", "geometry", "errors", "perception.fusion", "rearrangement.moves", "rearrangement.footprints"),
    "Stages and plugins": (
        "registry",
        "stages",
        "perception.stages",
        "rearrangement.stages",
        "plugin_kit.conformance",
        "weights.cards",
        "weights.resolve",
    ),
    "Perception": tuple(
        f"perception.{name}" for name in ("pipeline", "parts", "scene", "database", "crops", "regions", "lifting")
    ),
    "Rearrangement": (
        "rearrangement.episode",
        "rearrangement.sight",
        "rearrangement.paths",
        "rearrangement.drivers",
        "rearrangement.trajectories",
        "rearrangement.plans",
        "rearrangement.executors.drivers.recorded",
        "rearrangement.executors.handling.mover",
        "rearrangement.executors.replay",
        "rearrangement.planners.puzzles.rollout",
    ),
    "Experiments": (
        *(f"harness.{name}" for name in ("experiment", "drive", "kinds", "ablate", "rearrange", "attribution")),
        *(f"harness.{name}" for name in ("runs", "merge", "cache", "hooks.hook")),
        "settings",
        "parallel",
    ),
    "Rows and figures": (
        *(f"results.{name}" for name in ("rows", "scoring", "metrics", "stats", "comparisons", "completion")),
        "results.poses",
        "pictures.poses",
    ),
    "Data": tuple(
        f"data.{name}" for name in ("bop", "dataset", "tabletop", "scene", "conditions", "sensors", "objects")
    ),
    "Training": ("training.config", "training.run", "training.pairs"),
}
"""Heading -> modules of `toolkit`."""


def reference_pages() -> dict[str, str]:
    """Page -> Markdown, which mkdocstrings fills from the docstrings."""
    names = [name for group in MODULES.values() for name in group]
    return {f"reference/{name}.md": f"::: toolkit.{name}\n" for name in names}


def reference_nav() -> list[dict[str, list[dict[str, str]]]]:
    """The pages as a section of the nav."""
    return [
        {heading: [{f"toolkit.{name}": f"reference/{name}.md"} for name in names]} for heading, names in MODULES.items()
    ]
