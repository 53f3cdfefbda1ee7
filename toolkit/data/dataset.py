"""A benchmark on disk: a folder of captures 000000/ 000001/ ... and a dataset.json that says how it was made."""

from __future__ import annotations

import os
import shutil
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
from toolkit.files import write_json
from toolkit.parallel import Here, Workers
from toolkit.sim.bullet import require_pybullet

OnScene = Callable[[int, int], None]
"""Called with (finished, total) after every scene."""

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
    key = digest(
        {
            "config": config.model_dump(mode="json", exclude={"scenes", "objects"}),
            "objects": objects.digest,
            "source": source_digest("toolkit.data.tabletop"),
            "libraries": {name: version(name) for name in _LIBRARIES},
        }
    )
    folder = cache / "datasets" / key[:32]
    _build(config, objects, folder, cache, workers, on_scene, scenes)
    return folder


def build_dataset(
    config: TabletopConfig,
    out: Path,
    cache: Path,
    workers: Workers | None = None,
    on_scene: OnScene | None = None,
) -> Path:
    """Build a benchmark in a folder of its own.

    Args:
        config: its settings.
        out: the folder; it must be absent or empty.
        cache: where the object set's own files are kept.
        workers: who builds; scene k is the same whoever does. This process when left out.
        on_scene: progress.

    Raises:
        ToolkitError: the folder holds something, the object set does not load, the table does not hold the objects, or
            there is no PyBullet here.
    """
    require_pybullet()
    if out.exists() and any(out.iterdir()):
        raise ToolkitError(f"'{out}' is not empty; name a new folder")
    _build(config, object_set(config.objects, cache), out, cache, workers, on_scene)
    return out


def read_dataset(folder: Path) -> list[Path]:
    """Capture folders of a benchmark, in order.

    Raises:
        ToolkitError: there is no such folder, or no capture in it.
    """
    if not folder.is_dir():
        raise ToolkitError(f"dataset '{folder}' does not exist")
    captures = sorted(path for path in folder.iterdir() if (path / "current").is_dir())
    if not captures:
        raise ToolkitError(f"dataset '{folder}' holds no capture (a folder with current/ and goal/)")
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
    cache: Path,
    workers: Workers | None,
    on_scene: OnScene | None,
    scenes: Sequence[int] | None = None,
) -> None:
    needed = range(config.scenes) if scenes is None else scenes
    missing = [i for i in needed if not (folder / f"{i:06d}").is_dir()]
    finished = len(needed) - len(missing)
    if on_scene:
        on_scene(finished, len(needed))
    if not missing:
        return
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "dataset.json", _made(config, objects))
    for _ in (workers or Here()).map(partial(_build_one, config, objects, folder, cache), missing):
        finished += 1
        if on_scene:
            on_scene(finished, len(needed))


def _build_one(config: TabletopConfig, objects: ObjectSet, folder: Path, cache: Path, number: int) -> int:
    """Build a scene under a temporary name and rename it: a killed build leaves whole scenes only."""
    temporary = folder / f".{number:06d}.{os.getpid()}"
    shutil.rmtree(temporary, ignore_errors=True)
    build_scene(config, objects, number, temporary, cache)
    try:
        temporary.rename(folder / f"{number:06d}")
    except OSError:
        # Another process was faster; its scene is the same.
        shutil.rmtree(temporary)
    return number


def _made(config: TabletopConfig, objects: ObjectSet) -> dict[str, Any]:
    return {
        "schema": 1,
        "generator": "toolkit.data.tabletop",
        "toolkit": __version__,
        "config": config.model_dump(mode="json"),
        "object_set": {"name": objects.name, "digest": objects.digest, "objects": len(objects.assets)},
        "renderer": {"tiny": "PyBullet TinyRenderer", "egl": "PyBullet EGL plug-in"}[config.renderer],
        "libraries": {name: version(name) for name in _LIBRARIES},
    }
