"""Where captures come from: a folder of them, or the tabletop benchmark, built when first needed."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from toolkit.data.dataset import build_dataset, cached_dataset, object_set, read_dataset
from toolkit.data.tabletop import TabletopConfig
from toolkit.errors import ToolkitError
from toolkit.parallel import Workers, open_workers
from toolkit.paths import cache_root
from toolkit.progress import Advance, Progress
from toolkit.registry import validated
from toolkit.sim.bullet import require_pybullet


@dataclass(frozen=True)
class Dataset:
    """Capture folders.

    Attributes:
        captures: the folders by scene id.
        made: how they were made (dataset.json), or where they lie.
    """

    captures: dict[int, Path]
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


def count_scenes(settings: Mapping[str, Any]) -> int:
    """How many scenes a dataset has, whether they are there already or not.

    Args:
        settings: what `resolve_settings` returned.

    Raises:
        ToolkitError: the folder is no dataset, or holds fewer captures than the settings ask for.
    """
    return len(_existing(settings, _every).captures) if "path" in settings else settings["scenes"]


def require_source(settings: Mapping[str, Any]) -> None:
    """Make sure, before any work starts, that captures can be had; the settings are those of `open_dataset`.

    Raises:
        ToolkitError: scenes are to be simulated, and there is no PyBullet here.
    """
    if "path" not in settings:
        require_pybullet()


def _every(_: int) -> bool:
    return True


def open_dataset(
    settings: Mapping[str, Any],
    cache: Path,
    workers: Workers | None = None,
    progress: Progress | None = None,
    wanted: Callable[[int], bool] = _every,
) -> Dataset:
    """Find or build captures.

    Args:
        settings: what `resolve_settings` returned.
        cache: where object sets and built scenes are kept.
        workers: who builds; this process when left out.
        progress: shows a bar.
        wanted: says of a scene id whether it is needed.

    Raises:
        ToolkitError: the folder is no dataset, or the settings do not fit.
    """
    if "path" in settings:
        return _existing(settings, wanted)
    config = TabletopConfig.model_validate(settings)
    scenes = [i for i in range(config.scenes) if wanted(i)]
    progress = progress or Progress()
    _say_notes(config, cache, progress)
    with progress.step("Building scenes", len(scenes)) as advance:
        folder = cached_dataset(config, cache, workers, _each(advance), scenes)
    made = json.loads((folder / "dataset.json").read_text())
    return Dataset({i: folder / f"{i:06d}" for i in scenes}, made)


def open_capture(settings: Mapping[str, Any], cache: Path, scene_id: int) -> Path:
    """Find or build one capture of a dataset; the arguments are those of `open_dataset`.

    Raises:
        ToolkitError: as `open_dataset`; the dataset holds no such scene.
    """
    captures = open_dataset(settings, cache, wanted=lambda i: i == scene_id).captures
    if scene_id not in captures:
        raise ToolkitError(f"the dataset holds no scene {scene_id}; they are numbered from 0")
    return captures[scene_id]


def _existing(settings: Mapping[str, Any], wanted: Callable[[int], bool]) -> Dataset:
    folder = Path(settings["path"])
    captures = read_dataset(folder)
    scenes = settings.get("scenes", len(captures))
    if not isinstance(scenes, int) or not 1 <= scenes <= len(captures):
        raise ToolkitError(f"dataset: scenes is {scenes!r}, but '{folder}' holds {len(captures)} captures")
    numbered = {i: capture.absolute() for i, capture in enumerate(captures[:scenes]) if wanted(i)}
    return Dataset(numbered, {"path": str(folder.resolve())})


def build_tabletop(settings: Mapping[str, Any], out: Path, workers: int, progress: Progress) -> None:
    """Build a tabletop benchmark in a folder of its own.

    Raises:
        ToolkitError: as `toolkit.data.dataset.build_dataset`.
    """
    config = validated(TabletopConfig, dict(settings), "dataset")
    _say_notes(config, cache_root(), progress)
    with open_workers(workers, say=progress.say) as opened, progress.step("Building scenes", config.scenes) as advance:
        build_dataset(config, out.absolute(), cache_root(), opened, _each(advance))


def _say_notes(config: TabletopConfig, cache: Path, progress: Progress) -> None:
    for note in object_set(config.objects, cache).notes:
        progress.say(note)


def _each(advance: Advance) -> Callable[[int, int], None]:
    """Turn (finished, total) reports into steps of a bar."""
    shown = 0

    def report(finished: int, _: int) -> None:
        nonlocal shown
        advance(finished - shown)
        shown = finished

    return report
