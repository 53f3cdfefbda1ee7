"""What a process must have before it can run scenes: the same toolkit as all others, and every cell's stages."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any

import cv2

from toolkit.digests import digest, package_digest, source_digest
from toolkit.errors import ToolkitError
from toolkit.harness.cache import (
    Cache,
    CachedDescriptor,
    CachedMatcher,
    CachedSegmenter,
    library_versions,
    plugin_identity,
)
from toolkit.harness.experiment import Cell, Experiment, create_stage, own_settings, register_plugin_file
from toolkit.harness.runs import RunOptions
from toolkit.parallel import Workers, open_workers
from toolkit.paths import cache_root
from toolkit.perception.compiled import keep_compiled, share_accelerator
from toolkit.perception.meter import Meter
from toolkit.perception.pipeline import Pipeline, Stages
from toolkit.progress import Progress
from toolkit.registry import Plugin
from toolkit.results.rows import Row
from toolkit.results.scoring import score
from toolkit.slots import SLOTS
from toolkit.types import Capture, Failure, PoseEstimate, Segment

_WRAPPERS: dict[str, Any] = {
    "segmenter": CachedSegmenter,
    "goal_segmenter": CachedSegmenter,
    "descriptor": CachedDescriptor,
    "matcher": CachedMatcher,
}
"""Slots whose outputs are worth keeping."""


@dataclass(frozen=True)
class CellRunner:
    """A cell made ready to run.

    Attributes:
        cell: its settings.
        pipeline: its stages, wrapped by the cache where there is one.
        plugins: its stages by slot, as they are.
    """

    cell: Cell
    pipeline: Pipeline
    plugins: dict[str, Plugin[Any]]

    @cached_property
    def identity(self) -> str:
        """Digest of all that decides its rows, besides the capture."""
        return digest(
            [
                self.cell.resolved(),
                {slot: plugin_identity(plugin) for slot, plugin in self.plugins.items()},
                source_digest("toolkit.perception.pipeline"),
                source_digest("toolkit.results.scoring"),
                library_versions(),
            ]
        )

    @cached_property
    def weights(self) -> dict[str, str]:
        """sha256 by name of the weights its stages use."""
        return {name: sha256 for plugin in self.plugins.values() for name, sha256 in plugin.digests().items()}

    def rows(self, capture: Capture, scene_id: int) -> list[Row]:
        """Estimate and score one capture."""
        estimates = self._estimates(capture)
        return score(
            capture,
            estimates,
            cell=self.cell.name,
            dataset=digest(self.cell.dataset)[:16],
            settings=self.cell.settings,
            scene_id=scene_id,
            weights=self.weights,
        )

    def _estimates(self, capture: Capture) -> list[PoseEstimate]:
        """A stage that breaks on one scene fails that scene's objects by name; the run goes on."""
        try:
            return self.pipeline.run(capture)
        except ToolkitError:
            raise
        except Exception as error:
            failure = Failure("pipeline", f"{type(error).__name__}: {error}")
            masks = (capture.goal.true_masks or {}).values()
            return [PoseEstimate(i, Segment(mask), None, None, failure) for i, mask in enumerate(masks)]


def make_runner(cell: Cell, cache: Cache | None) -> CellRunner:
    """Make a cell's stages and pipeline.

    Raises:
        ToolkitError: a stage cannot be made.
    """
    keep_compiled()
    share_accelerator()
    meter = Meter()
    plugins: dict[str, Plugin[Any]] = {slot: create_stage(cell.pipeline, slot) for slot in SLOTS}
    stages: dict[str, Any] = dict(plugins)
    if cache is not None:
        for slot, wrapper in _WRAPPERS.items():
            stages[slot] = wrapper(stages[slot], plugins[slot], cache, meter)
    return CellRunner(cell, Pipeline(Stages(**stages), own_settings(cell.pipeline), cell.seed, meter), plugins)


@dataclass(frozen=True)
class WorkerSetup:
    """What a worker process, here or on another machine, must have to give the rows the main process would.

    Attributes:
        folder: where the command was given, so that relative paths mean the same; gone to where it exists.
        environment: variables by name: where the toolkit keeps and finds things.
        plugin_files: plugin files to load, absolute.
        source: digest of the toolkit's own code.
        libraries: versions by name.
    """

    folder: Path
    environment: tuple[tuple[str, str], ...]
    plugin_files: tuple[Path, ...]
    source: str
    libraries: tuple[tuple[str, str], ...]

    @staticmethod
    def of_this_process(plugin_files: Sequence[Path] = ()) -> WorkerSetup:
        """What this process has."""
        environment = {"TOOLKIT_CACHE": str(cache_root())}
        if "TOOLKIT_WEIGHTS" in os.environ:
            environment["TOOLKIT_WEIGHTS"] = str(Path(os.environ["TOOLKIT_WEIGHTS"]).absolute())
        files = tuple(dict.fromkeys(file.absolute() for file in plugin_files))
        libraries = tuple(library_versions().items())
        return WorkerSetup(Path.cwd(), tuple(environment.items()), files, package_digest(), libraries)

    def __call__(self) -> None:
        """Make this process ready; done once.

        Raises:
            ToolkitError: it has another toolkit or other versions, or a plugin file cannot be found here.
        """
        _prepare(self)


@lru_cache(maxsize=1)
def _prepare(setup: WorkerSetup) -> None:
    if setup.source != package_digest():
        raise ToolkitError("a worker has other toolkit code than this run began with; install the same everywhere")
    own = library_versions()
    differing = [f"{name} {own[name]} for {there}" for name, there in setup.libraries if own[name] != there]
    if differing:
        raise ToolkitError(f"a worker has other versions than this machine: {', '.join(differing)}; install the same")
    os.environ.update(setup.environment)
    if setup.folder.is_dir():
        os.chdir(setup.folder)
    # One thread per process, or workers fight for cores.
    cv2.setNumThreads(1)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    for file in setup.plugin_files:
        _load_once(file)


@cache
def _load_once(file: Path) -> None:
    register_plugin_file(file)


@contextmanager
def workers_for(experiment: Experiment, options: RunOptions, progress: Progress) -> Generator[Workers]:
    """The workers a run asks for, made ready for its experiment.

    Raises:
        ToolkitError: as `open_workers`.
    """
    prepare = WorkerSetup.of_this_process((*experiment.plugins, *options.plugin_files))
    with open_workers(options.workers, options.backend, options.address, prepare, progress.say) as workers:
        yield workers


_runners: dict[str, CellRunner] = {}


def get_runner(cell: Cell, cache: Cache | None) -> CellRunner:
    """The runner of a cell. Runners stay in their process: a network is loaded once, not once per scene."""
    key = json.dumps([cell.resolved(), str(cache)], sort_keys=True)
    if key not in _runners:
        _runners[key] = make_runner(cell, cache)
    return _runners[key]


def require_ready(cells: Sequence[Cell]) -> dict[str, str]:
    """Make sure of every stage before any work starts; returns the sha256 of all weights by name.

    Raises:
        ToolkitError: a stage cannot be made, or lacks something such as a checkpoint.
    """
    weights: dict[str, str] = {}
    for cell in cells:
        for slot in SLOTS:
            plugin = create_stage(cell.pipeline, slot)
            plugin.check_ready()
            weights |= plugin.digests()
    return weights
