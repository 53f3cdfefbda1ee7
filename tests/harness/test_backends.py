"""The same rows from every backend, from workers that die half-way, and from shards that are merged."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from command_line import toolkit
from pages import draw_no_pages

from toolkit.errors import ToolkitError
from toolkit.harness.ablate import Ablation
from toolkit.harness.drive import drive
from toolkit.harness.experiment import load_experiment
from toolkit.harness.merge import merge_shards
from toolkit.harness.rearrange import Rearrangement
from toolkit.harness.runs import RunOptions, Shard
from toolkit.harness.worker import WorkerSetup
from toolkit.parallel import open_workers
from toolkit.parallel.interrupts import without_interrupts
from toolkit.progress import Progress

PIPELINE = {
    "segmenter": "oracle",
    "goal_segmenter": "oracle",
    "associator": "oracle",
    "descriptor": "color_hist",
    "index": "faiss",
    "retriever": "instance_vote",
    "matcher": "mortal",
    "pnp": "poselib",
}
DATASET = {"scenes": 3, "min_objects": 2, "max_objects": 2, "views": 3, "supersample": 1, "renderer": "tiny"}
MORTAL = '''
"""SIFT whose process is killed when it is first used."""

import os
import signal
from pathlib import Path

from pydantic import Field

from toolkit.perception.matchers.sift import SiftConfig, SiftMatcher


class MortalConfig(SiftConfig):
    flag: Path = Field(Path("flag"), description="The file.")


class Mortal(SiftMatcher):
    """SIFT, once `flag` exists; before that, its process makes the file and dies."""

    name = "mortal"

    Config = MortalConfig

    def match(self, query, references):
        if not self.config.flag.exists():
            self.config.flag.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().match(query, references)
'''
BACKENDS = [
    "loky",
    pytest.param("dask", marks=pytest.mark.skipif(not importlib.util.find_spec("distributed"), reason="no dask here")),
    pytest.param("ray", marks=pytest.mark.skipif(not importlib.util.find_spec("ray"), reason="no ray here")),
]


class Heard(Progress):
    """Keeps what is said."""

    def __init__(self):
        super().__init__()
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """An experiment file that names its plugin, and nothing by an absolute path.

    One for the session: with work stealing, a module's tests may come in two parts, and a plugin has one file.
    """
    folder = tmp_path_factory.mktemp("experiment")
    (folder / "mortal.py").write_text(MORTAL)
    data = {
        "name": "small",
        "plugins": ["mortal.py"],
        "dataset": DATASET,
        "pipeline": PIPELINE,
        "sweep": {"pipeline.views": ["all", 1]},
    }
    (folder / "small.yaml").write_text(yaml.safe_dump(data))
    return folder


@pytest.fixture(scope="session")
def reference(folder):
    """The run of this process alone. The flag is a relative path: workers must find it all the same."""
    with pytest.MonkeyPatch.context() as patch:
        draw_no_pages(patch)
        patch.chdir(folder)
        (folder / "flag").touch()
        run = drive(Ablation(), load_experiment("small.yaml"), RunOptions(out=Path("reference"), use_cache=False))
        return folder / run


def lines(run: Path) -> list[str]:
    """The rows as they stand in the file, without times and whether the cache helped."""
    text = (run / "rows.jsonl").read_text()
    return re.sub(r'"time_ms":\{[^}]*\}|"cached":(true|false)', "", text).splitlines()


@pytest.mark.usefixtures("no_pages")
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_killed_worker_changes_nothing(backend, folder, reference, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "flag").unlink()
    heard = Heard()
    options = RunOptions(out=tmp_path / "run", workers=2, backend=backend, use_cache=False)
    run = drive(Ablation(), load_experiment("small.yaml"), options, heard)
    assert (folder / "flag").exists(), "no worker was killed"
    assert lines(run) == lines(reference)
    assert len(heard.lines) == (backend == "loky")


@pytest.mark.filterwarnings("error")
def test_another_cluster_on_the_machine_is_no_trouble():
    pytest.importorskip("distributed")
    with socket.socket() as taken:
        with suppress(OSError):  # another cluster has it already
            taken.bind(("", 8787))
            taken.listen()
        with open_workers(2, "dask") as workers:
            assert sorted(workers.map(abs, [-1, -2])) == [1, 2]


@pytest.mark.parametrize("backend", BACKENDS)
def test_work_that_kills_every_worker_ends_in_a_sentence(backend):
    with open_workers(2, backend) as workers:
        with pytest.raises(ToolkitError, match="workers were lost 4 times on the same work"):
            list(workers.map(os._exit, [1, 1]))
        # What is asked for next is done all the same.
        assert sorted(workers.map(abs, [-1, -2, -3])) == [1, 2, 3]


TASKS = """
import os, time
from pathlib import Path

kept = []

def grow(megabytes):
    import psutil
    kept.append(os.urandom(1) * (megabytes * 10**6))
    time.sleep(0.6)
    return os.getpid(), psutil.Process().memory_info().rss

def stay(_):
    Path(f"{os.getpid()}.pid").touch()
    time.sleep(600)
"""
GROWING = """
from tasks import grow
from toolkit.parallel import open_workers
from toolkit.parallel.interrupts import without_interrupts

with open_workers(2, say=print) as workers:
    first, second = list(workers.map(grow, [110] * 8)), list(workers.map(grow, [0] * 4))
print(len({pid for pid, _ in first}), {pid for pid, _ in second} <= {pid for pid, _ in first})
print(max(size for _, size in first) > 300e6)
"""
STAYING = """
from tasks import stay
from toolkit.parallel import open_workers
from toolkit.parallel.interrupts import without_interrupts

with open_workers(2) as workers:
    list(workers.map(stay, [1, 2]))
"""


def started(script: str, folder: Path, **options) -> subprocess.Popen:
    """A user's script that starts workers, without a guard around what it does."""
    (folder / "tasks.py").write_text(TASKS)
    (folder / "script.py").write_text(script)
    return subprocess.Popen([sys.executable, "script.py"], cwd=folder, stderr=subprocess.PIPE, text=True, **options)


def test_workers_that_grow_stay_and_nobody_warns(tmp_path):
    pytest.importorskip("psutil")  # without it, nobody looks at the size of a process
    assert started(GROWING, tmp_path, stdout=subprocess.PIPE).communicate(timeout=300) == ("2 True\nTrue\n", "")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_workers_end_with_their_main_process(number, tmp_path):
    main = started(STAYING, tmp_path, start_new_session=True)
    wait_for(lambda: len(list(tmp_path.glob("*.pid"))) == 2)
    # Ctrl-C goes to all processes of a terminal.
    os.killpg(main.pid, number) if number == signal.SIGINT else main.send_signal(number)
    main.communicate(timeout=60)
    wait_for(lambda: not any(Path("/proc", path.stem).exists() for path in tmp_path.glob("*.pid")))


@pytest.mark.parametrize("heard_by", ["this thread", "another thread"])
def test_ctrl_c_while_a_process_starts_is_put_off_and_not_lost(heard_by):
    sleep = "import time; time.sleep(600)"
    before, started, idle = signal.signal(signal.SIGINT, signal.default_int_handler), [], threading.Event()
    other = threading.Thread(target=idle.wait)
    other.start()
    ear, mouth = socket.socketpair()
    ear.settimeout(60)
    mouth.setblocking(False)
    wakeup = signal.set_wakeup_fd(mouth.fileno())
    try:
        with pytest.raises(KeyboardInterrupt), without_interrupts():
            signal.pthread_kill((threading.main_thread() if heard_by == "this thread" else other).ident, signal.SIGINT)
            if heard_by == "another thread":
                ear.recv(1)  # it has run, and the signal has reached Python
            started.append(subprocess.Popen([sys.executable, "-c", sleep]))
        started[0].send_signal(signal.SIGINT)
        with pytest.raises(subprocess.TimeoutExpired):
            started[0].wait(1)
    finally:
        signal.set_wakeup_fd(wakeup)
        signal.signal(signal.SIGINT, before)
        idle.set()
        ear.close()
        mouth.close()
        for process in started:
            process.kill()
            process.wait()


def wait_for(ready, seconds=60):
    deadline = time.monotonic() + seconds
    while not ready():
        assert time.monotonic() < deadline, "waited for too long"
        time.sleep(0.05)


@pytest.mark.usefixtures("no_pages")
def test_workers_share_the_cache(folder, reference, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setenv("TOOLKIT_CACHE", os.path.relpath(os.environ["TOOLKIT_CACHE"]))
    runs = [
        drive(Ablation(), load_experiment("small.yaml"), RunOptions(out=tmp_path / str(n), workers=n)) for n in (2, 1)
    ]
    assert lines(runs[0]) == lines(runs[1]) == lines(reference)
    assert all(json.loads(line)["cached"] for line in (runs[1] / "rows.jsonl").read_text().splitlines())


def test_a_cluster_without_workers_is_not_waited_for_for_ever(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("toolkit.parallel.dask._ALONE_S", 1)
    with open_workers(2, "dask") as workers:
        workers.client.cluster.scale(0)
        wait_for(lambda: not workers.client.scheduler_info()["workers"])
        with pytest.raises(ToolkitError, match="the dask cluster on this machine was lost; finished rows are kept"):
            list(workers.map(abs, [-1, -2]))


def test_a_worker_with_other_code_is_refused():
    setup = WorkerSetup.of_this_process()
    with pytest.raises(ToolkitError, match="a worker has other toolkit code"):
        WorkerSetup(setup.folder, (), (), "other", setup.libraries)()
    other = tuple((name, "0.0" if name == "numpy" else version) for name, version in setup.libraries)
    with pytest.raises(ToolkitError, match=r"numpy [\d.]+ for 0\.0"):
        WorkerSetup(setup.folder, (), (), setup.source, other)()


MISTAKES = {
    "unknown backend": (("loki", None), "did you mean 'loky'?"),
    "address for loky": (("loky", "here:1"), "goes with --backend dask or ray"),
    "dask nowhere": (("dask", "tcp://127.0.0.1:9"), "the dask scheduler at 'tcp://127.0.0.1:9' does not answer"),
    "dask nonsense": (("dask", "xyz://1"), "the dask scheduler at 'xyz://1' does not answer"),
    "ray nowhere": (("ray", "127.0.0.1:9"), "the ray cluster at '127.0.0.1:9' does not answer"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_cluster_that_is_not_there_is_one_sentence(case, monkeypatch):
    (backend, address), said = MISTAKES[case]
    if backend in ("dask", "ray"):
        pytest.importorskip("distributed" if backend == "dask" else "ray")
    if backend == "dask":
        monkeypatch.setattr("toolkit.parallel.dask._PATIENCE_S", 2)
    with pytest.raises(ToolkitError) as error, open_workers(2, backend, address):
        pass
    assert said in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(("backend", "module"), [("dask", "distributed"), ("ray", "ray")])
def test_a_missing_extra_is_one_sentence(backend, module, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ToolkitError, match=rf"pip install 'rearrange-toolkit\[{backend}\]'"), open_workers(1, backend):
        pass


def test_the_command_line_goes_to_a_cluster_by_its_address(folder, reference, tmp_path):
    """A scheduler and a worker with two threads, started in another folder, as on another machine."""
    pytest.importorskip("distributed")
    (tmp_path / "elsewhere").mkdir()
    address = tmp_path / "scheduler.json"
    without_cache = {k: v for k, v in os.environ.items() if k != "TOOLKIT_CACHE"}
    parts = [
        ["dask_scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", address],
        ["dask_worker", "--scheduler-file", address, "--nthreads", "2", "--no-dashboard"],
    ]
    processes = []
    try:
        for module, *arguments in parts:
            call = [sys.executable, "-m", f"distributed.cli.{module}", *map(str, arguments)]
            processes.append(
                subprocess.Popen(call, cwd=tmp_path / "elsewhere", env=without_cache, stderr=subprocess.DEVNULL)
            )
        deadline = time.monotonic() + 60
        while not address.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        where = json.loads(address.read_text())["address"]
        command = ["ablate", "small.yaml", "--backend", "dask", "--address", where, "--out", tmp_path / "run"]
        done = subprocess.run(
            [sys.executable, "-P", "-c", "from toolkit.cli.commands import main; main()", *map(str, command)],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=300,
        )
        assert done.returncode == 0, done.stderr
        assert lines(tmp_path / "run") == lines(reference)
    finally:
        for process in processes:
            process.send_signal(signal.SIGTERM)
            process.wait(30)


# Shards


@pytest.fixture(scope="session")
def shards(folder, reference, tmp_path_factory):
    """Both halves of the experiment, and the whole of it."""
    out = tmp_path_factory.mktemp("shards")
    with pytest.MonkeyPatch.context() as patch:
        draw_no_pages(patch)
        patch.chdir(folder)
        for number in (1, 2):
            options = RunOptions(out=out / str(number), shard=Shard(number, 2))
            drive(Ablation(), load_experiment("small.yaml"), options)
        drive(Ablation(), load_experiment("small.yaml"), RunOptions(out=out / "whole"))
    return out


@pytest.mark.usefixtures("no_pages")
def test_shards_merge_to_the_run_in_one_piece(shards, tmp_path):
    merged = merge_shards([shards / "2", shards / "1"], tmp_path / "merged")
    assert lines(merged) == lines(shards / "whole")
    for name in ("experiment.resolved.yaml", "summary.csv"):
        assert len((merged / name).read_text()) == pytest.approx(len((shards / "whole" / name).read_text()), abs=400)
    assert (merged / "experiment.resolved.yaml").read_text() == (
        shards / "whole" / "experiment.resolved.yaml"
    ).read_text()


def test_the_command_line_merges_and_reports(shards, tmp_path):
    done = toolkit("report", shards / "1", shards / "2")
    assert done.returncode == 2 and "name its folder with --out" in done.stderr
    done = toolkit("report", shards / "1", shards / "2", "--out", tmp_path / "merged")
    assert done.returncode == 0, done.stderr
    assert "views=all" in done.stdout and (tmp_path / "merged" / "report.html").stat().st_size > 10_000


def edited(shards: Path, tmp_path: Path, number: str, change) -> Path:
    """A copy of a shard with something else in it."""
    return change(shutil.copytree(shards / number, tmp_path / "edited"))


def _other_seed(run: Path) -> Path:
    settings = yaml.safe_load((run / "experiment.resolved.yaml").read_text())
    settings["cells"][1]["pipeline"]["min_matches"] = 7
    (run / "experiment.resolved.yaml").write_text(yaml.safe_dump(settings))
    return run


def _other_code(run: Path) -> Path:
    meta = json.loads((run / "meta.json").read_text())
    (run / "meta.json").write_text(json.dumps({**meta, "source": "other"}))
    return run


def _unfinished(run: Path) -> Path:
    (run / "summary.csv").unlink()
    return run


def _of_three(run: Path) -> Path:
    text = (run / "experiment.resolved.yaml").read_text()
    (run / "experiment.resolved.yaml").write_text(text.replace("2/2", "2/3"))
    return run


def _strays(run: Path) -> Path:
    text = (run / "rows.jsonl").read_text()
    (run / "rows.jsonl").write_text(text.replace('"scene_id":1', '"scene_id":2'))
    return run


CONFLICTS = {
    "settings": (_other_seed, r"differ in cells\.1\.pipeline\.min_matches \(7 and 6\)"),
    "code": (_other_code, "were made with other code"),
    "unfinished": (_unfinished, "is not finished; run its command again with --resume"),
    "counts": (_of_three, "is shard 2/3, but .* is one of 2"),
    "rows": (_strays, "is shard 2/2, but holds rows of scene 2"),
}


@pytest.mark.parametrize("case", CONFLICTS)
def test_shards_that_do_not_fit_are_refused(case, shards, tmp_path):
    change, said = CONFLICTS[case]
    with pytest.raises(ToolkitError, match=said):
        merge_shards([shards / "1", edited(shards, tmp_path, "2", change)], tmp_path / "merged")
    assert not (tmp_path / "merged" / "summary.csv").exists()


def test_shards_twice_or_missing_are_refused(shards, tmp_path):
    for runs, said in [
        (["1", "1"], "are both shard 1/2"),
        (["2"], "shard 1/2 is missing"),
        (["1", "whole"], "holds all scenes already"),
    ]:
        with pytest.raises(ToolkitError, match=said):
            merge_shards([shards / name for name in runs], tmp_path / "merged")


@pytest.mark.parametrize("text", ["3/2", "0/2", "1", "a/b", "1/2/3", "-1/2"])
def test_a_shard_is_a_part_of_a_whole(text):
    with pytest.raises(ToolkitError, match="--shard takes I/N"):
        Shard.parse(text)


@pytest.mark.usefixtures("no_pages")
def test_rearrangements_shard_too(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "flag").touch()
    changes = {"dataset.scenes": [2], "pipeline.views": ["all"], "rearrange.rounds": [1]}
    loaded = load_experiment("small.yaml", changes, rearranges=True)
    runs = [
        drive(Rearrangement(), loaded, RunOptions(out=tmp_path / str(number), shard=Shard(number, 2)))
        for number in (1, 2)
    ]
    whole = drive(Rearrangement(), loaded, RunOptions(out=tmp_path / "whole"))
    assert lines(merge_shards(runs, tmp_path / "merged")) == lines(whole)
    with pytest.raises(ToolkitError, match="fewer scenes than shards"):
        drive(Rearrangement(), loaded, RunOptions(out=tmp_path / "none", shard=Shard(3, 3)))
