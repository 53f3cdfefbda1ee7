"""Where PyBullet cannot be had, all works but what simulates, and that says so in one sentence."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import toolkit
from toolkit.harness.experiment import load_experiment

BLOCK = """
import sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"pybullet", "pybullet_data", "eglRenderer"}:
            raise ModuleNotFoundError(f"No module named {name!r}")

sys.meta_path.insert(0, Blocker())
"""
"""Stands in sitecustomize.py, so that workers and probes start without PyBullet too."""

SENTENCE = "simulating scenes needs PyBullet, which has wheels for CPython 3.11 on Linux (x86-64) only"


@pytest.fixture
def run(tmp_path: Path):
    """Runs Python in an empty folder, on what is then a machine without PyBullet."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(BLOCK)
    (tmp_path / "work").mkdir()
    paths = [str(tmp_path / "site"), str(Path(toolkit.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]

    def run(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-P", "-c", code, *map(str, arguments)],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths)), "COLUMNS": "200", "NO_COLOR": "1"},
            cwd=tmp_path / "work",
            capture_output=True,
            text=True,
            check=False,
        )

    return run


@pytest.fixture
def command(run):
    """Runs one command there; gives its exit code, and all it said."""

    def command(*arguments: object) -> tuple[int, str]:
        done = run("from toolkit.cli.commands import main; main()", *arguments)
        return done.returncode, done.stdout + done.stderr

    return command


def test_it_is_blocked(run):
    assert run("import pybullet").returncode == 1


def test_every_module_imports_or_says_the_sentence(run):
    code = """
import importlib, json, pkgutil, toolkit
failed, names = {}, [m.name for m in pkgutil.walk_packages(toolkit.__path__, "toolkit.")]
for name in names:
    try:
        importlib.import_module(name)
    except Exception as error:
        failed[name] = f"{type(error).__name__}: {error}"
print(json.dumps([len(names), failed]))
"""
    count, failed = json.loads(run(code).stdout)
    assert count > 100
    assert not {name: why for name, why in failed.items() if not why.startswith(f"ToolkitError: {SENTENCE}")}


def test_estimating_evaluating_and_reporting_work(command, dataset):
    for arguments in (
        ("estimate", dataset / "000000", "--out", "poses"),
        ("evaluate", dataset, "--out", "evaluated", "--refiner", "none", "--pnp", "poselib"),
        ("report", "evaluated"),
        ("dataset", "show", dataset),
    ):
        code, said = command(*arguments)
        assert code == 0, said


def test_an_ablation_of_captures_that_exist_works(command, dataset, tmp_path):
    experiment = load_experiment("quick").model_dump(mode="json", exclude={"sweep", "rearrange"})
    file = tmp_path / "mine.yaml"
    file.write_text(json.dumps({**experiment, "dataset": {"path": str(dataset)}}))
    code, said = command("ablate", file, "--out", "run", "--workers", "2")
    assert code == 0, said


@pytest.mark.parametrize(
    "arguments",
    [
        ("list",),
        ("show", "matcher", "sift"),
        ("show", "executor", "arm"),
        ("check", "index", "faiss"),
        ("check", "planner", "optimal"),
        ("weights", "list"),
        ("plugin", "new", "matcher", "mine"),
    ],
    ids=" ".join,
)
def test_what_needs_no_simulator_works(command, arguments):
    code, said = command(*arguments)
    assert code == 0, said
    assert "cannot be used" not in said


@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="the extra `view` is not installed")
def test_viewing_a_capture_works(command, dataset):
    code, said = command("view", dataset / "000000", "--save", "scene.rrd")
    assert code == 0, said


@pytest.mark.parametrize(
    "arguments",
    [
        ("dataset", "build", "captures"),
        ("ablate",),
        ("rearrange",),
        ("rearrange", "arm", "--set", "rearrange.executor.robot=panda"),
        ("check", "executor", "kinematic"),
        ("train", "loftr"),
    ],
    ids=" ".join,
)
def test_what_simulates_says_so_before_it_does_anything(command, arguments, tmp_path):
    code, said = command(*arguments)
    assert code == 2
    assert said.splitlines()[-1].startswith(f"error: {SENTENCE}")
    assert "Traceback" not in said
    assert not list((tmp_path / "work").iterdir())


def test_the_doctor_names_it(command):
    code, said = command("doctor")
    assert code == 0
    assert f"simulator: none here; {SENTENCE}" in said
    assert "renderer: none" in said
