"""A benchmark on disk: a folder of captures 000000/ 000001/ ... and a dataset.json that says how it was made."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from toolkit import __version__
from toolkit.data.objects import ObjectSet, load_object_set
from toolkit.data.tabletop import TabletopConfig, build_scene
from toolkit.digests import digest, source_digest
from toolkit.errors import ToolkitError
from toolkit.files import is_whole, make_once, write_json
from toolkit.parallel import Here, Workers
from toolkit.sim.bullet import require_pybullet

OnScene = Callable[[int, int], None]
"""Called with (finished, total) after every scene."""

_MADE = "dataset.json"
_GENERATOR = "toolkit.data.tabletop"
_LIBRARIES = ("numpy", "opencv-python-headless", "pybullet", "scipy", "trimesh")


def cached_dataset(
    config: TabletopConfig,
    cache: Path,
    workers: Workers | None = None,
    on_scene: OnScene | None = None,
    scenes: Sequence[int] | None = None,
) -> Path:
    """The benchmark in the cache, its missing scenes built; scenes are shared whatever number is asked for.

    Args:
        config: its settings.
        cache: where it is kept.
        workers: who builds; this process when left out.
        on_scene: progress.
        scenes: the scenes that are needed; all when left out.

    Raises:
        ToolkitError: as `build_dataset`.
    """
    require_pybullet()
    objects = object_set(config.objects, cache)
    settings = config.model_dump(mode="json", exclude={"scenes"})
    key = digest(
        {
            "config": {name: value for name, value in settings.items() if name != "objects"},
            "objects": objects.digest,
            "source": source_digest("toolkit.data.tabletop"),
            "libraries": {name: version(name) for name in _LIBRARIES},
        }
    )
    folder = cache / "datasets" / key[:32]
    made = _made(settings, config.renderer, objects)
    _build(config, objects, folder, made, cache, workers, on_scene, range(config.scenes) if scenes is None else scenes)
    return folder


def build_dataset(
    config: TabletopConfig,
    out: Path,
    cache: Path,
    workers: Workers | None = None,
    on_scene: OnScene | None = None,
) -> Path:
    """Build a benchmark in a folder of its own, or go on with one that was stopped.

    Args:
        config: its settings.
        out: the folder; it must be absent, empty, or a benchmark of the same settings, or of others with no scene yet.
        cache: where the object set's own files are kept.
        workers: who builds; scene k is the same whoever does. This process when left out.
        on_scene: progress.

    Raises:
        ToolkitError: the folder holds something else, the object set does not load, the table does not hold the
            objects, or there is no PyBullet here.
    """
    require_pybullet()
    objects = object_set(config.objects, cache)
    made = _made(config.model_dump(mode="json"), config.renderer, objects)
    if out.exists() and not out.is_dir():
        raise ToolkitError(f"'{out}' is a file; name a folder")
    held = {path.name for path in out.glob("[!.]*")}
    earlier = _read_made(out)
    # A call whose settings do not work leaves dataset.json alone behind.
    unbuilt = held == {_MADE} and earlier.get("generator") == _GENERATOR
    if held and not unbuilt and earlier != made:
        raise ToolkitError(f"'{out}' is not empty; name a new folder")
    _build(config, objects, out, made, cache, workers, on_scene, range(config.scenes))
    return out


def read_dataset(folder: Path) -> list[Path]:
    """Capture folders of a benchmark, in order.

    Raises:
        ToolkitError: there is no such folder, no capture in it, or it was not built to its end.
    """
    if not folder.is_dir():
        raise ToolkitError(f"dataset '{folder}' does not exist")
    if (folder / "current").is_dir():
        raise ToolkitError(
            f"'{folder}' is one capture, and no folder of captures; ask `toolkit capture check {folder}` what is in it"
        )
    captures = sorted(p for p in folder.iterdir() if (p / "current").is_dir() and not p.name.startswith("."))
    if not captures:
        raise ToolkitError(f"dataset '{folder}' holds no capture (a folder with current/ and goal/)")
    made = _read_made(folder)
    if made.get("generator") == _GENERATOR and len(captures) < made["config"].get("scenes", 0):
        raise ToolkitError(
            f"dataset '{folder}' has {len(captures)} of the {made['config']['scenes']} scenes its {_MADE} speaks of; "
            f"give the command that builds it again, or remove {_MADE} where this is meant"
        )
    return captures


@lru_cache(maxsize=4)
def object_set(source: str, cache: Path) -> ObjectSet:
    """The object set, as `load_object_set`; its files have absolute paths, which workers open from any folder."""
    procedural = source == "procedural"
    return load_object_set(source if procedural else str(Path(source).expanduser().absolute()), cache)


def _build(
    config: TabletopConfig,
    objects: ObjectSet,
    folder: Path,
    made: dict[str, Any],
    cache: Path,
    workers: Workers | None,
    on_scene: OnScene | None,
    needed: Sequence[int],
) -> None:
    missing = [i for i in needed if not is_whole(folder / f"{i:06d}")]
    finished = len(needed) - len(missing)
    if on_scene:
        on_scene(finished, len(needed))
    if _read_made(folder) != made:
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / _MADE, made)
    for _ in (workers or Here()).map(partial(_build_one, config, objects, folder, cache), missing):
        finished += 1
        if on_scene:
            on_scene(finished, len(needed))


def _build_one(config: TabletopConfig, objects: ObjectSet, folder: Path, cache: Path, number: int) -> int:
    make_once(folder / f"{number:06d}", lambda scene: build_scene(config, objects, number, scene, cache))
    return number


def _made(settings: dict[str, Any], renderer: str, objects: ObjectSet) -> dict[str, Any]:
    """What dataset.json says. One in the cache names no number of scenes: it grows."""
    return {
        "schema": 1,
        "generator": _GENERATOR,
        "toolkit": __version__,
        "config": settings,
        "object_set": {"name": objects.name, "digest": objects.digest, "objects": len(objects.assets)},
        "renderer": {"tiny": "PyBullet TinyRenderer", "egl": "PyBullet EGL plug-in"}[renderer],
        "libraries": {name: version(name) for name in _LIBRARIES},
    }


def _read_made(folder: Path) -> dict[str, Any]:
    """What dataset.json says; nothing where there is none that can be read."""
    try:
        made: Any = json.loads((folder / _MADE).read_text())
    except (OSError, ValueError):
        return {}
    return made if isinstance(made, dict) else {}
