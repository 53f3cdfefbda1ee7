"""Hooks are told of a run what they are to be told, and none can lose it."""

from __future__ import annotations

import math
import sys
from collections import defaultdict
from pathlib import Path
from types import ModuleType

import pytest
from test_drive import CELLS, Counting

from toolkit.errors import ToolkitError
from toolkit.harness.drive import drive
from toolkit.harness.experiment import load_experiment, register_plugin_file
from toolkit.harness.hooks import HOOKS
from toolkit.harness.hooks.hook import RunHook
from toolkit.harness.runs import RunOptions
from toolkit.progress import Progress
from toolkit.registry import Plugin

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "mlflow_hook.py"


@pytest.fixture
def experiment():
    """Three scenes in two cells."""
    return load_experiment("quick", {"dataset.scenes": [3], "pipeline.views": ["all", 1]})


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """What a test registers is gone after it."""
    monkeypatch.setattr(HOOKS, "_entries", dict(HOOKS._entries))


class Told(Plugin, RunHook):
    stage, name = "hook", "told"
    heard: list[tuple[str, object]] = []  # noqa: RUF012

    def begin(self, start):
        self.heard.append(("begin", (start.run, start.experiment, start.tasks)))

    def rows(self, rows):
        self.heard.append(("rows", {row.scene_id for row in rows}))

    def table(self, lines):
        self.heard.append(("table", lines))

    def end(self, run):
        self.heard.append(("end", run))


class Failing(Plugin, RunHook):
    stage, name = "hook", "failing"

    def rows(self, rows):
        raise OSError("the service\nis away")

    def end(self, run):
        raise AssertionError("told although it has failed")


class Said(Progress):
    def __init__(self):
        super().__init__()
        self.lines = []

    def say(self, text):
        self.lines.append(text)


@pytest.fixture
def heard():
    Told.heard = []
    HOOKS.register(Told, "a test")
    HOOKS.register(Failing, "a test")
    return Told.heard


def test_a_hook_hears_of_a_run_from_its_begin_to_its_end(experiment, heard, tmp_path):
    run = drive(Counting(), experiment, RunOptions(out=tmp_path / "run", log=("told",)))
    scenes = [("rows", {2}), ("rows", {1}), ("rows", {0})]
    table = ("table", [{"cell": cell, "rows": 6} for cell in CELLS])
    assert heard == [("begin", (run, "quick", 6)), *scenes, table, ("end", run)]


def test_a_hook_that_fails_is_said_once_and_loses_nothing(experiment, heard, tmp_path):
    said = Said()
    run = drive(Counting(), experiment, RunOptions(out=tmp_path / "run", log=("failing", "told")), said)
    (line,) = said.lines
    assert line.startswith("hook 'failing' failed and is told no more; the run goes on: OSError: the service is away")
    assert heard[-1] == ("end", run) and (run / "report.html").exists()


def test_a_run_that_fails_ends_without_a_folder(experiment, heard, tmp_path):
    class Breaking(Counting):
        def run_scene(self, task):
            raise ToolkitError("broken")

    with pytest.raises(ToolkitError, match="broken"):
        drive(Breaking(), experiment, RunOptions(out=tmp_path / "run", log=("told",)))
    assert [what for what, _ in heard] == ["begin", "end"] and heard[-1][1] is None


def test_an_unknown_hook_is_refused_before_any_work(experiment, tmp_path):
    with pytest.raises(ToolkitError, match="unknown hook 'tensorbord'; did you mean 'tensorboard'"):
        drive(Counting(), experiment, RunOptions(out=tmp_path / "run", log=("tensorbord",)))
    assert not (tmp_path / "run").exists()


def test_the_documented_hook_logs_to_mlflow(experiment, monkeypatch, tmp_path):
    calls = defaultdict(list)
    mlflow = ModuleType("mlflow")
    for name in ("set_experiment", "start_run", "log_dict", "log_metrics", "log_artifacts", "end_run"):
        setattr(mlflow, name, lambda *values, _name=name, **_: calls[_name].append(values))
    monkeypatch.setitem(sys.modules, "mlflow", mlflow)
    register_plugin_file(EXAMPLE)
    run = drive(Counting(), experiment, RunOptions(out=tmp_path / "run", log=("mlflow",)))
    assert calls["set_experiment"] == [("quick",)] and calls["end_run"] == [("FINISHED",)]
    assert calls["log_metrics"] == [({"views_all/rows": 6},), ({"views_1/rows": 6},)]
    assert calls["log_artifacts"] == [(str(run),)]
    assert calls["log_dict"][0][0]["experiment"] == "quick"


def test_tensorboard_reads_what_its_hook_writes(experiment, tmp_path):
    pytest.importorskip("tensorboard", reason="pip install 'rearrange-toolkit[tensorboard]'")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    run = drive(Counting(), experiment, RunOptions(out=tmp_path / "run", log=("tensorboard",)))
    events = EventAccumulator(str(run / "tensorboard")).Reload()
    for cell in CELLS:
        assert [event.step for event in events.Scalars(f"objects right/{cell}")] == [2, 4, 6]
        assert math.isclose(events.Scalars(f"rows/{cell}")[0].value, 6)


def test_without_tensorboard_its_hook_says_what_to_install(experiment, monkeypatch, tmp_path):
    monkeypatch.setattr("toolkit.harness.hooks.tensorboard.find_spec", lambda name: None)
    with pytest.raises(ToolkitError, match=r"pip install 'rearrange-toolkit\[tensorboard\]'"):
        drive(Counting(), experiment, RunOptions(out=tmp_path / "run", log=("tensorboard",)))
