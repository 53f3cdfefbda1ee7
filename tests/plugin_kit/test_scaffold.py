"""`toolkit plugin new`: what it writes works as it stands, loaded by path and installed."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest
import yaml

from toolkit.errors import ToolkitError
from toolkit.plugin_kit.conformance import Subject, check_plugin, checks_of, run_check
from toolkit.plugin_kit.scaffold import new_plugin
from toolkit.registry import load_plugin_file
from toolkit.results.completion import MoveRow
from toolkit.results.rows import read_rows_as
from toolkit.stages import REGISTRIES

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("stage", REGISTRIES)
def test_a_new_plugin_passes_every_check_of_its_stage(stage, tmp_path):
    folder = new_plugin(stage, "my_own", tmp_path / "new")
    plugin = load_plugin_file(folder / "toolkit_my_own.py").MyOwn
    assert (plugin.stage, plugin.name) == (stage, "my_own")
    wrong = [f"{outcome.check}: {outcome.note}" for outcome in check_plugin(plugin) if not outcome.passed]
    assert not wrong
    assert plugin.Config.model_fields
    assert "emplate" not in (folder / "toolkit_my_own.py").read_text()
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    assert project["entry-points"] == {REGISTRIES[stage].group: {"my_own": "toolkit_my_own:MyOwn"}}


def test_it_installs_and_its_own_test_passes(tmp_path):
    folder = new_plugin("index", "blockwise", tmp_path / "new")
    site = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--target", site]
    subprocess.run([*map(str, pip), str(folder)], check=True)
    path = os.pathsep.join(map(str, (site, ROOT)))
    environment = {**os.environ, "PYTHONPATH": path, "NO_COLOR": "1", "COLUMNS": "160"}

    def run(*command):
        return subprocess.run(
            [sys.executable, *command], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )

    done = run("-c", "from toolkit.cli.commands import main; main()", "check", "index", "blockwise")
    assert done.returncode == 0, done.stderr
    assert "passes all 10 checks" in done.stdout
    done = run("-m", "pytest", "-q", "-p", "toolkit.plugin_kit.pytest_plugin", "-p", "no:cacheprovider", "tests")
    assert "10 passed" in done.stdout, done.stdout


def test_a_new_grasper_and_motion_planner_work_in_the_arm(tmp_path):
    """Loaded by path, chosen and set as every stage is, and an object ends where it was to be put."""
    plugins = [new_plugin(stage, f"my_{stage}", tmp_path / stage) for stage in ("grasp", "motion")]
    chosen = {
        "rearrange.executor.robot": "panda",
        "rearrange.executor.grasp.name": "my_grasp",
        "rearrange.executor.grasp.spare_m": "0.008",
        "rearrange.executor.motion.name": "my_motion",
        "rearrange.executor.motion.goal_share": "0.3",
        "rearrange.rounds": "1",
        "dataset.views": "3",
        "dataset.renderer": "tiny",
        "dataset.supersample": "1",
        "dataset.rotation_deg": "60",
    }
    arguments = ["rearrange", "arm", "--scenes", "1", "--seed", "7", "--workers", "1", "--out", tmp_path / "run"]
    arguments += ["--pnp", "poselib", "--refiner", "none"]
    arguments += [word for folder in plugins for word in ("--plugin", folder / f"toolkit_my_{folder.name}.py")]
    arguments += [word for path, value in chosen.items() for word in ("--set", f"{path}={value}")]
    done = subprocess.run(
        [sys.executable, "-P", "-c", "from toolkit.cli.commands import main; main()", *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    rows = read_rows_as(MoveRow, tmp_path / "run" / "rows.jsonl")
    assert any(row.success_sym and row.moves for row in rows) and rows[0].motion_s > 5
    (cell,) = yaml.safe_load((tmp_path / "run" / "experiment.resolved.yaml").read_text())["cells"]
    parts = cell["rearrange"]["executor"]
    assert parts["grasp"] == {"name": "my_grasp", "spare_m": 0.008, "depth_m": 0.03}
    assert parts["motion"]["name"] == "my_motion" and parts["motion"]["goal_share"] == 0.3


MISTAKES = {
    "unknown stage": (("matchr", "mine"), "did you mean 'matcher'?"),
    "a name with a capital": (("matcher", "Mine"), "use a-z"),
    "a name that is taken": (("matcher", "sift"), "there is a matcher 'sift' already"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_mistakes_are_named(case, tmp_path):
    arguments, said = MISTAKES[case]
    with pytest.raises(ToolkitError) as caught:
        new_plugin(*arguments, tmp_path / "new")
    assert said in str(caught.value)
    assert not (tmp_path / "new").exists()


def test_a_folder_that_holds_something_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ToolkitError, match="not empty"):
        new_plugin("index", "blockwise", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_templates_stay_plugins_themselves():
    template = import_module("toolkit.plugin_kit.scaffold.templates.retriever").Template
    assert all(run_check(check, Subject(template)).passed for check in checks_of("retriever"))
