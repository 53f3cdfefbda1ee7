"""Runs end to end: tables, cache, resuming after a kill, plugins, and what a user gets wrong."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import yaml
from pages import draw_no_pages

from toolkit.errors import ToolkitError
from toolkit.harness.ablate import Ablation
from toolkit.harness.drive import drive
from toolkit.harness.experiment import expand, load_experiment
from toolkit.harness.runs import RunOptions, open_run
from toolkit.results.rows import append_rows, read_rows

PIPELINE = {
    "segmenter": "oracle",
    "goal_segmenter": "oracle",
    "associator": "kmeans",
    "descriptor": "color_hist",
    "index": "faiss",
    "retriever": "instance_vote",
    "matcher": "sift",
    "pnp": "poselib",
}
PLUGIN = Path(__file__).parents[2] / "docs" / "examples" / "orb_matcher.py"


@pytest.fixture
def experiment(tmp_path):
    """A small experiment file: two scenes of two objects, multi-view and single-view."""
    data = {
        "name": "small",
        "dataset": {"scenes": 2, "min_objects": 2, "max_objects": 2, "views": 3, "supersample": 1},
        "pipeline": PIPELINE,
        "sweep": {"pipeline.views": ["all", 1]},
    }
    path = tmp_path / "small.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def lines(run: Path) -> list[dict]:
    """The rows without what may differ between two runs: times, and whether the cache helped."""
    rows = [json.loads(line) for line in (run / "rows.jsonl").read_text().splitlines()]
    return [{key: value for key, value in row.items() if key not in {"time_ms", "cached"}} for row in rows]


def command(*arguments: object, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-P", "-c", "from toolkit.cli.commands import main; main()", *map(str, arguments)],
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def test_a_run_writes_everything_and_the_cache_serves_the_next(experiment, tmp_path, monkeypatch):
    first = drive(Ablation(), load_experiment(str(experiment)), RunOptions(out=tmp_path / "first", workers=2))
    for name in ("experiment.resolved.yaml", "meta.json", "rows.jsonl", "summary.csv", "report.html"):
        assert (first / name).stat().st_size > 0
    rows = read_rows(first / "rows.jsonl")
    assert {row.cell for row in rows} == {"views=all", "views=1"}
    assert len(rows) == 2 * 2 * 2
    draw_no_pages(monkeypatch)
    second = drive(Ablation(), load_experiment(str(experiment)), RunOptions(out=tmp_path / "second"))
    assert lines(second) == lines(first)
    assert all(row.cached for row in read_rows(second / "rows.jsonl"))
    without = drive(Ablation(), load_experiment(str(experiment)), RunOptions(out=tmp_path / "third", use_cache=False))
    assert lines(without) == lines(first)
    assert not any(row.cached for row in read_rows(without / "rows.jsonl"))


def test_the_issue_s_four_cells_share_their_scenes():
    overrides = {"pipeline.matcher": ["sift", "loftr"], "pipeline.pnp": ["poselib", "jax_ransac"]}
    cells = expand(load_experiment("quick", overrides))
    assert [(c.pipeline.matcher.name, c.pipeline.pnp.name) for c in cells] == [
        ("sift", "poselib"),
        ("sift", "jax_ransac"),
        ("loftr", "poselib"),
        ("loftr", "jax_ransac"),
    ]
    assert len({json.dumps(c.dataset, sort_keys=True) for c in cells}) == 1


def test_missing_weights_stop_the_command_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setenv("TOOLKIT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("toolkit.weights.resolve.fetch", _no_network)
    experiment = load_experiment("quick", {"pipeline.matcher": ["sift", {"name": "loftr", "weights": "outdoor"}]})
    with pytest.raises(ToolkitError, match=r"put loftr_outdoor\.ckpt into"):
        drive(Ablation(), experiment, RunOptions(out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()
    assert not (tmp_path / "cache").exists()


def _no_network(source, target, sha256, size_mb):
    raise OSError("no route to host")


@pytest.mark.usefixtures("no_pages")
def test_killed_runs_resume_to_the_same_rows(experiment, tmp_path):
    """SIGKILL when a random number of bytes has been written, several times over; then an undisturbed resume."""
    reference = drive(Ablation(), load_experiment(str(experiment)), RunOptions(out=tmp_path / "reference"))
    size = (reference / "rows.jsonl").stat().st_size
    run = tmp_path / "killed"
    rng = np.random.default_rng(int(time.time()))
    for attempt, target in enumerate(sorted(rng.integers(0, size, 3).tolist())):
        resume = ["--resume"] if attempt and (run / "experiment.resolved.yaml").exists() else ["--fresh"]
        process = command("ablate", experiment, "--out", run, "--no-cache", "--workers", 1, *resume)
        while process.poll() is None and not _has_bytes(run / "rows.jsonl", target):
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    process = command("ablate", experiment, "--out", run, "--no-cache", "--workers", 1, "--resume")
    _, error = process.communicate(timeout=300)
    assert process.returncode == 0, error
    assert lines(run) == lines(reference)
    assert (run / "report.html").exists()


def _has_bytes(path: Path, target: int) -> bool:
    return path.exists() and path.stat().st_size > target


@pytest.mark.usefixtures("no_pages")
def test_rows_cut_anywhere_resume_to_the_same_rows(experiment, tmp_path):
    """Every place a write can be torn at, without waiting for a process."""
    run = drive(Ablation(), load_experiment(str(experiment)), RunOptions(out=tmp_path / "run"))
    whole = (run / "rows.jsonl").read_bytes()
    expected = lines(run)
    for cut in np.linspace(1, len(whole) - 1, 7).astype(int):
        (run / "rows.jsonl").write_bytes(whole[:cut])
        drive(Ablation(), load_experiment(str(experiment)), RunOptions(out=run, resume=True))
        assert lines(run) == expected


@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_keeps_the_finished_rows(experiment, tmp_path, workers):
    run = tmp_path / "run"
    process = command("ablate", experiment, "--out", run, "--no-cache", "--workers", workers)
    while process.poll() is None and not _has_bytes(run / "rows.jsonl", 0):
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=120)
    assert "Traceback" not in error
    if process.returncode != 0:  # it may have been as good as done
        assert process.returncode == 130
        assert "--resume" in error
    assert len(read_rows(run / "rows.jsonl")) > 0


@pytest.mark.usefixtures("no_pages")
def test_a_run_folder_is_never_overwritten_by_accident(experiment, tmp_path):
    loaded = load_experiment(str(experiment))
    run = drive(Ablation(), loaded, RunOptions(out=tmp_path / "run"))
    with pytest.raises(ToolkitError, match="already holds a run"):
        drive(Ablation(), loaded, RunOptions(out=run))
    with pytest.raises(ToolkitError, match="no run with these settings"):
        drive(Ablation(), load_experiment(str(experiment), {"seed": [7]}), RunOptions(out=run, resume=True))


def test_runs_that_begin_in_the_same_second_do_not_meet(tmp_path, monkeypatch):
    class Stopped(datetime):
        @classmethod
        def now(cls, tz=None):
            return cls(2026, 1, 2, 3, 4, 5, tzinfo=tz)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("toolkit.harness.runs.datetime", Stopped)
    runs = [open_run("small", {"of": n}, None, resume=False, fresh=False) for n in range(3)]
    assert len({*runs}) == 3
    assert [open_run("small", {"of": n}, None, resume=True, fresh=False) for n in range(3)] == runs


@pytest.mark.parametrize("place", ["/proc/nowhere/run", "/dev/null/run"])
def test_an_unwritable_run_folder_is_one_sentence(experiment, place):
    with pytest.raises(ToolkitError, match="cannot write"):
        drive(Ablation(), load_experiment(str(experiment)), RunOptions(out=Path(place)))


def test_a_full_disk_is_one_sentence_and_keeps_the_rows(experiment, tmp_path, monkeypatch):
    calls = []

    def full(path, rows):
        calls.append(path)
        if len(calls) > 1:
            raise OSError(28, "No space left on device")
        append_rows(path, rows)

    monkeypatch.setattr("toolkit.harness.drive.append_rows", full)
    with pytest.raises(ToolkitError, match="No space left on device; finished rows are kept"):
        drive(Ablation(), load_experiment(str(experiment)), RunOptions(out=tmp_path / "run"))
    assert len(read_rows(tmp_path / "run" / "rows.jsonl")) > 0


def test_a_plugin_file_adds_a_matcher(experiment, tmp_path):
    text = PLUGIN.read_text()
    assert len([line for line in text.splitlines() if line.strip()]) <= 40
    process = command(
        "ablate", experiment, "--plugin", PLUGIN, "--matcher", "orb", "--matcher", "sift", "--out", tmp_path / "run"
    )
    output, error = process.communicate(timeout=300)
    assert process.returncode == 0, error
    assert "matcher=orb" in output
    assert {row.settings["pipeline.matcher"] for row in read_rows(tmp_path / "run" / "rows.jsonl")} == {"orb", "sift"}


@pytest.mark.usefixtures("no_pages")
def test_worker_count_changes_no_row(experiment, tmp_path):
    runs = [
        drive(
            Ablation(), load_experiment(str(experiment)), RunOptions(out=tmp_path / f"{n}", workers=n, use_cache=False)
        )
        for n in (1, 2)
    ]
    assert lines(runs[0]) == lines(runs[1])
