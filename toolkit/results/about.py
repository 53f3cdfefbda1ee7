"""What a run was of, in words: its title, what all its cells share, and what sets each of them apart."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from toolkit.results.folder import META, RESOLVED

_OF_SCENES = ("path", "objects", "scenes", "views", "rotation_deg", "track")
"""Settings of a dataset that are named where all cells share them; the others stand among all settings."""


@dataclass(frozen=True)
class About:
    """What a run was of.

    Attributes:
        title: the experiment's.
        description: the experiment's, in a sentence.
        command: what was typed; empty where it is not known.
        reference: the cell that the others were to be compared with; empty for the first.
        shared: settings that all cells share, by name: of the scenes, every stage, and the pipeline's own.
        own: what sets each cell apart; empty for a run of one cell.
        settings: everything, as YAML.
        meta: versions and the like, as written down before the first row.
    """

    title: str
    description: str = ""
    command: str = ""
    reference: str = ""
    shared: Mapping[str, str] = field(default_factory=dict[str, str])
    own: Mapping[str, str] = field(default_factory=dict[str, str])
    settings: str = ""
    meta: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @classmethod
    def read(cls, run: Path) -> About:
        """What a run's folder says; what it does not say is left out."""
        settings = read_if_there(run / RESOLVED)
        meta: dict[str, Any] = json.loads(read_if_there(run / META) or "{}")
        resolved: dict[str, Any] = yaml.safe_load(settings) or {}
        said: dict[str, str] = meta.get("experiment", {})
        program, *words = meta.get("command") or [""]
        cells = {cell["cell"]: _by_name(cell) for cell in resolved.get("cells") or []}
        shared, own = _apart(cells)
        return cls(
            title=said.get("title") or resolved.get("experiment") or run.name,
            description=said.get("description", ""),
            command=shlex.join([Path(program).name, *words]) if words else "",
            reference=said.get("reference", ""),
            shared=shared,
            own=own if len(cells) > 1 else {},
            settings=settings,
            meta=meta,
        )


def read_if_there(path: Path) -> str:
    """A file's text, empty where there is no such file."""
    return path.read_text() if path.exists() else ""


def _by_name(cell: Mapping[str, Any]) -> dict[str, str]:
    """A cell's settings by name; a stage's own stand behind its slot and a dot."""
    found: dict[str, str] = {}
    for part in ("dataset", "pipeline", "rearrange"):
        for key, value in cell.get(part, {}).items():
            if isinstance(value, dict) and "name" in value:
                found[key] = value["name"]
                found |= {f"{key}.{name}": _short(own) for name, own in value.items() if name != "name"}
            else:
                found[f"scenes.{key}" if part == "dataset" else key] = _short(value)
    return found


def _short(value: Any) -> str:
    if isinstance(value, Mapping):
        return str(value.get("name", dict(value)))
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _names_weights(key: str) -> bool:
    """Whether a setting says which checkpoint a stage has: two of one architecture are two methods."""
    return key.endswith(".weights")


def _apart(cells: Mapping[str, Mapping[str, str]]) -> tuple[dict[str, str], dict[str, str]]:
    """The settings all cells share, without the stages' own; and for every cell those that differ, in words."""
    keys: Sequence[str] = list(dict.fromkeys(key for cell in cells.values() for key in cell))
    differing = [key for key in keys if len({cell.get(key) for cell in cells.values()}) > 1]
    stages = {key for key in differing if "." not in key}
    shown = [key for key in differing if key.partition(".")[0] not in stages or key in stages or _names_weights(key)]
    first = next(iter(cells.values()), {})
    shared = {
        key.removeprefix("scenes."): first[key]
        for key in keys
        if key not in differing and ("." not in key or key.removeprefix("scenes.") in _OF_SCENES)
    }
    own = {
        name: "; ".join(f"{key.removeprefix('scenes.').replace('_', ' ')} {cell[key]}" for key in shown if key in cell)
        for name, cell in cells.items()
    }
    return shared, own
