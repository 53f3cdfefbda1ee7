"""Whatever is made once and kept is whole, though four processes make it at the same time and one of them is killed."""

from __future__ import annotations

import hashlib
import http.server
import json
import multiprocessing
import os
import shutil
import signal
import sys
import threading
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
import trimesh

from toolkit.data import procedural
from toolkit.data.dataset import build_dataset, cached_dataset
from toolkit.data.lookalikes import with_lookalikes
from toolkit.data.objects import load_object_set
from toolkit.data.table import table_files
from toolkit.data.tabletop import TabletopConfig
from toolkit.harness.cache import Cache
from toolkit.models.efficientnet_lite import EfficientNetLite0
from toolkit.progress import Progress
from toolkit.sim.robot_urdfs import gen3_urdf
from toolkit.training import pool
from toolkit.training.config import MixvprTraining
from toolkit.training.mixvpr import MixvprTask
from toolkit.training.pool import PoolConfig, procedural_pool
from toolkit.weights.cards import WeightCard
from toolkit.weights.resolve import resolve_weights

FEW = {name: (procedural.FAMILIES[name][0], 2) for name in ("can", "mug")}
"""Families and counts of the procedural set in place of eleven families."""

DATASET = TabletopConfig(scenes=1, min_objects=2, max_objects=2, views=1, supersample=1, renderer="tiny")
POOL = {"objects_per_family": 4, "objects_per_scene": 8, "frames": 2, "focal_px": (300, 475), "renderer": "tiny"}
MIXVPR = {
    "loop": {"steps": 1, "batch": 4, "learning_rate": 1e-3, "warmup": 0, "decay": 0, "average": 0.5}
    | {"evaluate_every": 1, "checkpoint_every": 1, "bf16": False},
    "pool": POOL,
    "held_out_frames": 2,
    "crops_per_view": 1,
    "views_per_object": 2,
}
KEPT = {"masks": np.arange(200_000, dtype=np.uint8), "scores": np.linspace(0, 1, 3)}


class _Server(http.server.BaseHTTPRequestHandler):
    """Serves a checkpoint and its companions."""

    def do_GET(self) -> None:
        body = self.path.encode() * 50_000
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: Any) -> None:
        pass


def make_recolored(cache: Path, given: Path) -> None:
    with_lookalikes(load_object_set("procedural", cache).assets[:2], "recolored", cache)


def make_stage_outputs(cache: Path, given: Path) -> None:
    stages = Cache(cache / "stages")
    if stages.load("00key") is None:
        stages.store("00key", KEPT)
    found = stages.load("00key")
    assert all(np.array_equal(found[name], array) for name, array in KEPT.items())


def make_weights(cache: Path, given: Path) -> None:
    address = (given / "server").read_text()
    card = WeightCard("w", "folder/w.bin", "none", "CC0-1.0", 0.3, (f"{address}/w.bin",), "none", companions=("w.txt",))
    resolve_weights(card)


def make_robot(cache: Path, given: Path) -> None:
    gen3_urdf()


def make_pool(cache: Path, given: Path) -> None:
    procedural_pool(PoolConfig(**POOL), cache, Progress(), held_out=False)


def make_maps(cache: Path, given: Path) -> None:
    MixvprTask(MixvprTraining.model_validate(MIXVPR), cache, None, None, given / "backbone.pth", Progress())


MAKERS = {
    "procedural objects": ("objects/procedural-*", lambda cache, given: load_object_set("procedural", cache)),
    "hulls of scans": ("objects/hulls", lambda cache, given: load_object_set(str(given / "scans"), cache)),
    "recolored objects": ("objects/recolored", make_recolored),
    "tables": ("objects/table-1-cloth", lambda cache, given: table_files("cloth", cache)),
    "scenes": ("datasets", lambda cache, given: cached_dataset(DATASET, cache)),
    "a dataset": ("mine", lambda cache, given: build_dataset(DATASET, cache / "mine", cache)),
    "training objects": ("objects/training-*", make_pool),
    "training pool": ("training-pools/training-*", make_pool),
    "backbone maps": ("training-pools/maps-*", make_maps),
    "stage outputs": ("stages", make_stage_outputs),
    "weights": ("weights", make_weights),
    "robots": ("robots/gen3-*", make_robot),
}
"""What is made, where in the cache, and by what."""


@pytest.fixture(scope="module")
def processes():
    """Processes that have imported everything already: they are forked from one that did nothing else."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["toolkit.training.mixvpr", "toolkit.harness.cache", "toolkit.sim.robot_urdfs"])
    return context


@pytest.fixture(scope="module")
def given(processes, tmp_path_factory):
    """What makers start from: scans without hulls, random weights, an address; and a cache that has it all."""
    given = tmp_path_factory.mktemp("given")
    procedural.write_set(given / "scans", {"can": 2})
    for hull in (given / "scans").glob("*/*.stl"):
        hull.unlink()
    torch.manual_seed(0)
    torch.save(EfficientNetLite0().state_dict(), given / "backbone.pth")
    robot = given / "cache" / "robots" / "kinova_robot_model"
    (robot / "meshes" / "collision").mkdir(parents=True)
    trimesh.creation.icosphere().export(robot / "meshes" / "collision" / "link.stl")
    (robot / "kinova_robotiq.urdf").write_text('<collision>"meshes/collision/link.stl"</collision>')
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Server) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        (given / "server").write_text(f"http://127.0.0.1:{server.server_port}")
        for maker in MAKERS:
            assert run(processes, maker, given / "cache", given)[0] == [0]
        yield given
        server.shutdown()


def tree(folder: Path) -> dict[str, str]:
    """sha256 of every file by its name, without what is being written."""
    found = {}
    for parent, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.endswith(".tmp")]
        for path in (Path(parent) / name for name in files if not name.endswith(".tmp")):
            found[str(path.relative_to(folder))] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def child(maker: str, cache: Path, given: Path, report: Path, barrier: Any, die_at: int | None) -> None:
    """One process: make, and write down what is there then and how often it wrote; or die at a write of its own."""
    os.environ["TOOLKIT_CACHE"] = str(cache)
    os.environ.pop("TOOLKIT_WEIGHTS", None)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    procedural.FAMILIES = pool.FAMILIES = FEW
    pool._WIDTH, pool._HEIGHT = 320, 240
    writes = 0

    def count(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal writes
        changes = event in ("os.rename", "os.mkdir") or (event == "open" and set(str(arguments[1])) & set("wax+"))
        if changes and str(arguments[0]).startswith(str(cache)):
            writes += 1
            if writes == die_at:
                barrier.wait()
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(count)
    if die_at is None:
        barrier.wait()
    MAKERS[maker][1](cache, given)
    report.write_text(json.dumps({"tree": tree(cache), "writes": writes}))


def run(processes, maker: str, cache: Path, given: Path, die_at: tuple[int | None, ...] = (None,)):
    """As many processes as `die_at` has entries start together; returns their exit codes and the survivors' reports."""
    barrier = processes.Barrier(len(die_at), timeout=120)
    reports = [cache.with_name(f"{cache.name}-{i}.json") for i in range(len(die_at))]
    arguments = [(maker, cache, given, report, barrier, die) for report, die in zip(reports, die_at, strict=True)]
    started = [processes.Process(target=child, args=a) for a in arguments]
    for process in started:
        process.start()
    for process in started:
        process.join(120)
    return [process.exitcode for process in started], [json.loads(r.read_text()) for r in reports if r.exists()]


def own(maker: str, cache: Path) -> list[Path]:
    """What a maker made."""
    return list(cache.glob(MAKERS[maker][0]))


def halve(folder: Path) -> None:
    """Leave what an older version's killed process would have left: no list, and half of the files."""
    for listed in folder.rglob(".whole.json"):
        listed.unlink()
        next(path for path in sorted(listed.parent.rglob("*")) if path.is_file()).unlink()
    for entry in folder.rglob("*.entry"):
        entry.write_bytes(entry.read_bytes()[:1000])


@pytest.mark.parametrize("maker", MAKERS)
def test_four_make_it_at_once_and_one_is_killed(maker, processes, given, tmp_path):
    whole = tree(given / "cache")
    for name in ("alone", "together"):
        shutil.copytree(given / "cache", tmp_path / name)
        for path in own(maker, tmp_path / name):
            shutil.rmtree(path)
    assert tree(tmp_path / "alone") != whole

    codes, (alone,) = run(processes, maker, tmp_path / "alone", given)
    assert codes == [0] and alone["tree"] == whole and alone["writes"] > 1

    together = tmp_path / "together"
    codes, survivors = run(processes, maker, together, given, (alone["writes"] // 2 + 1, None, None, None))
    assert codes == [-signal.SIGKILL, 0, 0, 0]
    assert [survivor["tree"] for survivor in survivors] == [whole] * 3

    codes, (later,) = run(processes, maker, together, given)
    assert codes == [0] and later == {"tree": whole, "writes": 0}

    for path in own(maker, together):
        halve(path)
    codes, halved = run(processes, maker, together, given, (None, None))
    assert codes == [0, 0] and [found["tree"] for found in halved] == [whole] * 2
