"""A page a stage, from its registry: every implementation with its settings, and the weights it may use."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

from settings_pages import in_cell, registry_page, settings_table

from toolkit.perception import stages as perception
from toolkit.rearrangement import stages as rearrangement
from toolkit.registry import Plugin, Registry
from toolkit.stages import REGISTRIES
from toolkit.weights.cards import CARDS, WeightCard

WINGS = (perception, rearrangement)


def stage_pages() -> dict[str, str]:
    """Page -> Markdown: one per stage, and an overview. Only what the toolkit itself brings is listed.

    Raises:
        ToolkitError: an implementation does not import.
    """
    return {"stages/index.md": _overview()} | {f"stages/{registry_page(r)}": _stage(r) for r in REGISTRIES.values()}


def stage_nav() -> list[str | dict[str, str]]:
    """The pages as a section of the nav."""
    return ["stages/index.md", *({name: f"stages/{registry_page(registry)}"} for name, registry in REGISTRIES.items())]


def _plugins(registry: Registry[Any]) -> Iterator[type[Plugin]]:
    return (registry.get(entry.name) for entry in registry.entries() if entry.origin == "toolkit")


def _protocol(stage: str) -> type:
    """The Protocol that the stage's registry is annotated with, in the wing that defines both."""
    wing, name = next((w, n) for w in WINGS for n, value in vars(w).items() if value is REGISTRIES[stage])
    found = re.fullmatch(r"Registry\[(\w+)\]", wing.__annotations__[name])
    assert found is not None, name
    return getattr(wing, found[1])


def _overview() -> str:
    lines = [
        "# Stages",
        "",
        "Every stage of the pipeline and every implementation the toolkit brings, as the registries had them when this"
        " site was built. `toolkit list` prints the same and what plugins add; `toolkit show STAGE NAME` prints one.",
        "",
        "| stage | what it does | implementations |",
        "| --- | --- | --- |",
    ]
    for stage, registry in REGISTRIES.items():
        links = ", ".join(f"[`{p.name}`]({registry_page(registry)}#{p.name})" for p in _plugins(registry))
        lines.append(f"| [{stage}]({registry_page(registry)}) | {in_cell(_summary(_protocol(stage)))} | {links} |")
    lines += ["", "## Weights", "", *_weights_table(CARDS.values()), ""]
    return "\n".join(lines)


def _stage(registry: Registry[Any]) -> str:
    protocol, plugins = _protocol(registry.stage), list(_plugins(registry))
    lines = [
        f"# {registry.stage}",
        "",
        f"{_summary(protocol)} Its Protocol is [`{protocol.__name__}`][{protocol.__module__}.{protocol.__name__}];"
        f" plugins announce theirs under the entry-point group `{registry.group}`.",
        "",
        "| name | what it is | weights |",
        "| --- | --- | --- |",
        *(f"| [`{p.name}`](#{p.name}) | {in_cell(_summary(p))} | {_licences(p)} |" for p in plugins),
    ]
    for plugin in plugins:
        lines += ["", f"## {plugin.name}", "", inspect.getdoc(plugin) or "", "", *settings_table(plugin.Config)]
        if plugin.weights:
            lines += ["", *_weights_table(CARDS[name] for name in plugin.weights)]
    return "\n".join(lines) + "\n"


def _weights_table(cards: Any) -> list[str]:
    return [
        "| weights | what they are | licence | MB |",
        "| --- | --- | --- | ---: |",
        *(f"| `{c.name}`<br>{c.file} | {in_cell(c.architecture)} | {_licence(c)} | {c.size_mb:.1f} |" for c in cards),
    ]


def _licences(plugin: type[Plugin]) -> str:
    return "; ".join(dict.fromkeys(_licence(CARDS[name]) for name in plugin.weights)) or "none"


def _licence(card: WeightCard) -> str:
    return f"{card.licence}{', **non-commercial**' if card.non_commercial else ''}"


def _summary(thing: type) -> str:
    return (inspect.getdoc(thing) or "").partition("\n")[0]
