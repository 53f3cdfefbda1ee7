"""Where captures come from: a folder of them, or the tabletop benchmark, built when first needed."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from toolkit.data.dataset import build_dataset, cached_capture, cached_dataset, read_dataset
from toolkit.data.tabletop import TabletopConfig
from toolkit.errors import ToolkitError
from toolkit.paths import cache_root
from toolkit.progress import Advance, Progress
from toolkit.registry import validated


@dataclass(frozen=True)
class Dataset:
    """A list of capture folders.

    Attributes:
        captures: the folders; the position is the scene id.
        made: how they were made (dataset.json), or where they lie.
    """

    captures: tuple[Path, ...]
    made: dict[str, Any]


def resolve_settings(settings: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Check the `dataset:` part of an experiment and write out every default.

    Args:
        settings: `{path: FOLDER}`, optionally with `scenes`; or the tabletop benchmark's settings.
        seed: the benchmark's seed, unless the settings name one.

    Raises:
        ToolkitError: an unknown key or a value that does not fit.
    """
    if "path" in settings:
        unknown = sorted(set(settings) - {"path", "scenes"})
        if unknown:
            raise ToolkitError(f"dataset: '{unknown[0]}' cannot be set for captures that exist already (path is given)")
        return dict(settings)
    return validated(TabletopConfig, {"seed": seed, **settings}, "dataset").model_dump(mode="json")


def open_dataset(
    settings: Mapping[str, Any], cache: Path, workers: int = 1, progress: Progress | None = None
) -> Dataset:
    """Find or build captures.

    Args:
        settings: what `resolve_settings` returned.
        cache: where object sets and built scenes are kept.
        workers: processes that build.
        progress: shows a bar.

    Raises:
        ToolkitError: the folder is no dataset, or the settings do not fit.
    """
    if "path" in settings:
        return _existing(settings)
    config = TabletopConfig.model_validate(settings)
    with (progress or Progress()).step("Building scenes", config.scenes) as advance:
        folder = cached_dataset(config, cache, workers, _each(advance))
    made = json.loads((folder / "dataset.json").read_text())
    return Dataset(tuple(read_dataset(folder)[: config.scenes]), made)


def open_capture(settings: Mapping[str, Any], cache: Path, scene_id: int) -> Path:
    """Find or build one capture of a dataset; the arguments are those of `open_dataset`.

    Raises:
        ToolkitError: as `open_dataset`; there are fewer captures.
    """
    if "path" not in settings:
        return cached_capture(TabletopConfig.model_validate(settings), scene_id, cache)
    captures = _existing(settings).captures
    if scene_id >= len(captures):
        raise ToolkitError(f"'{settings['path']}' holds {len(captures)} captures, none of number {scene_id}")
    return captures[scene_id]


def _existing(settings: Mapping[str, Any]) -> Dataset:
    folder = Path(settings["path"])
    captures = read_dataset(folder)
    scenes = settings.get("scenes", len(captures))
    if not isinstance(scenes, int) or not 1 <= scenes <= len(captures):
        raise ToolkitError(f"dataset: scenes is {scenes!r}, but '{folder}' holds {len(captures)} captures")
    return Dataset(tuple(captures[:scenes]), {"path": str(folder.resolve())})


def build_tabletop(settings: Mapping[str, Any], out: Path, workers: int, progress: Progress) -> None:
    """Build a tabletop benchmark in a folder of its own.

    Raises:
        ToolkitError: as `toolkit.data.dataset.build_dataset`.
    """
    config = validated(TabletopConfig, dict(settings), "dataset")
    with progress.step("Building scenes", config.scenes) as advance:
        build_dataset(config, out, cache_root(), workers, _each(advance))


def _each(advance: Advance) -> Callable[[int, int], None]:
    """Turn (finished, total) reports into steps of a bar."""
    shown = 0

    def report(finished: int, _: int) -> None:
        nonlocal shown
        advance(finished - shown)
        shown = finished

    return report
