"""Shared fixtures. Everything lives in temporary folders: tests never touch a user's cache."""

from __future__ import annotations

import importlib.util
import os
import shutil
from pathlib import Path

# One thread per process, also of commands that tests start: those of xdist's workers would wait for each other.
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OPENBLAS_NUM_THREADS"] = "1"
# And one process per command, unless a test asks for more.
os.environ["LOKY_MAX_CPU_COUNT"] = "1"

import jax
import numpy as np
import pytest
from pages import draw_no_pages

from toolkit.data.bop import load_capture
from toolkit.data.dataset import cached_dataset
from toolkit.data.tabletop import TabletopConfig
from toolkit.geometry import look_at
from toolkit.types import Camera, Capture

if importlib.util.find_spec("pybullet") is None:
    collect_ignore = ["cli", "experiments", "harness", "sim", "training", "test_docs.py", "test_makers.py"]
    collect_ignore += ["data/test_tabletop.py", "data/test_tracks.py", "pictures/test_recording.py"]
    collect_ignore += ["plugin_kit/test_scaffold.py", "rearrangement/test_arm.py", "rearrangement/test_executors.py"]
    """What simulates, and cannot where PyBullet is not to be had; `.ci/run` tests it, on a machine that has it."""


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One cache for the session, so that sets, scenes and XLA's programs are made once; xdist's workers share it."""
    base = tmp_path_factory.getbasetemp()
    root = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "toolkit-cache"
    os.environ["TOOLKIT_CACHE"] = str(root)
    programs = {"jax_compilation_cache_dir": str(root / "xla"), "jax_persistent_cache_min_compile_time_secs": 0}
    for name, value in programs.items():
        jax.config.update(name, value)
        os.environ[name.upper()] = str(value)  # for commands that tests start
    return root


@pytest.fixture
def no_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of this process draw no page and no pictures."""
    draw_no_pages(monkeypatch)


@pytest.fixture
def no_plots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages have all but their plots: most of what a page computes."""
    from toolkit.results.report.plots import Plot

    monkeypatch.setattr(Plot, "svg", lambda self: "")
    monkeypatch.setattr(Plot, "write", lambda self, folder: None)


@pytest.fixture(scope="session")
def dataset(cache: Path) -> Path:
    """Two scenes of three procedural objects, four views; skips where PyBullet cannot be had."""
    pytest.importorskip("pybullet")
    config = TabletopConfig(scenes=2, min_objects=3, max_objects=3, views=4, seed=5, renderer="tiny")
    return cached_dataset(config, cache)


@pytest.fixture(scope="session")
def capture(dataset: Path) -> Capture:
    """The first scene."""
    return load_capture(dataset / "000000")


@pytest.fixture
def capture_copy(dataset: Path, tmp_path: Path) -> Path:
    """A capture folder to damage."""
    return shutil.copytree(dataset / "000000", tmp_path / "capture")


@pytest.fixture
def camera() -> Camera:
    """A 640x480 camera that looks down at the origin from the front."""
    K = np.array([[600.0, 0, 319.5], [0, 610.0, 239.5], [0, 0, 1]])
    return Camera(K, look_at(np.array([0.1, -0.7, 0.6]), np.zeros(3)), 640, 480)
