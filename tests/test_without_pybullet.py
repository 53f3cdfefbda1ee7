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

SEVERAL = """
import contextlib, io, json, sys
from toolkit.cli.commands import main

answers = []
for arguments in json.loads(sys.argv[1]):
    sys.argv, said, code = ["toolkit", *arguments], io.StringIO(), 0
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    answers.append([code, said.getvalue()])
print(json.dumps(answers))
"""

SENTENCE = "simulating scenes needs PyBullet, which has wheels for CPython 3.11 on Linux (x86-64) only"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("machine")


@pytest.fixture(scope="module")
def run(folder: Path):
    """Runs Python in an empty folder, on what is then a machine without PyBullet."""
    (folder / "site").mkdir()
    (folder / "site" / "sitecustomize.py").write_text(BLOCK)
    (folder / "work").mkdir()
    paths = [str(folder / "site"), str(Path(toolkit.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]

    def run(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-P", "-c", code, *map(str, arguments)],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths)), "COLUMNS": "200", "NO_COLOR": "1"},
            cwd=folder / "work",
            capture_output=True,
            text=True,
            check=False,
        )

    return run


@pytest.fixture(scope="module")
def command(run):
    """Runs one command there; gives its exit code, and all it said."""

    def command(*arguments: object) -> tuple[int, str]:
        done = run("from toolkit.cli.commands import main; main()", *arguments)
        return done.returncode, done.stdout + done.stderr

    return command


@pytest.fixture(scope="module")
def commands(run):
    """Runs several commands there in one process, which loads all that is heavy once; their exit codes and words."""

    def commands(*each: tuple[str, ...]) -> list[tuple[int, str]]:
        done = run(SEVERAL, json.dumps(each))
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return commands


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


def test_estimating_evaluating_and_reporting_work(commands, dataset):
    answers = commands(
        ("estimate", str(dataset / "000000"), "--out", "poses"),
        ("evaluate", str(dataset), "--out", "evaluated", "--refiner", "none", "--pnp", "poselib"),
        ("report", "evaluated"),
        ("dataset", "show", str(dataset)),
    )
    for code, said in answers:
        assert code == 0, said


def test_an_ablation_of_captures_that_exist_works(command, dataset, tmp_path):
    experiment = load_experiment("quick").model_dump(mode="json", exclude={"sweep", "rearrange"})
    file = tmp_path / "mine.yaml"
    file.write_text(json.dumps({**experiment, "dataset": {"path": str(dataset)}}))
    code, said = command("ablate", file, "--out", "run", "--workers", "2")
    assert code == 0, said


def test_what_needs_no_simulator_works(commands):
    answers = commands(
        ("list",),
        ("show", "matcher", "sift"),
        ("show", "executor", "arm"),
        ("check", "index", "faiss"),
        ("check", "planner", "optimal"),
        ("weights", "list"),
        ("plugin", "new", "matcher", "mine"),
    )
    for code, said in answers:
        assert code == 0, said
        assert "cannot be used" not in said


@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="the extra `view` is not installed")
def test_viewing_a_capture_works(command, dataset):
    code, said = command("view", dataset / "000000", "--save", "scene.rrd")
    assert code == 0, said


def test_what_simulates_says_so_before_it_does_anything(commands, folder):
    before = set((folder / "work").iterdir())
    answers = commands(
        ("dataset", "build", "captures"),
        ("ablate",),
        ("rearrange",),
        ("rearrange", "arm", "--set", "rearrange.executor.robot=panda"),
        ("check", "executor", "kinematic"),
        ("train", "loftr"),
    )
    for code, said in answers:
        assert code == 2, said
        assert said.splitlines()[-1].startswith(f"error: {SENTENCE}")
        assert "Traceback" not in said
    assert set((folder / "work").iterdir()) == before


def test_the_doctor_names_it(command):
    code, said = command("doctor")
    assert code == 0
    assert f"simulator: none here; {SENTENCE}" in said
    assert "renderer: none" in said
