"""The public modules, by what one comes to them for: pages of the API reference."""

from __future__ import annotations

MODULES: dict[str, tuple[str, ...]] = {
    "Values": ("types", "moves", "footprints", "fusion", "geometry", "errors"),
    "Stages and plugins": ("registry", "stages", "conformance", "weights.cards", "weights.resolve"),
    "Perception": ("pipeline", "database", "crops", "regions", "lifting"),
    "Rearrangement": ("episode", "sight", "executors.replay", "planners.rollout", "motion.paths"),
    "Experiments": ("experiment", "ablate", "rearrange", "attribution", "runs", "merge", "parallel", "cache"),
    "Rows and figures": ("evaluate", "metrics", "stats", "results", "comparisons", "completion"),
    "Data": ("data.bop", "data.dataset", "data.tabletop", "data.objects"),
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
