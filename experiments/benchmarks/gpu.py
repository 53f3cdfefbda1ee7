"""The same pipelines with JAX and torch on the processor and on a GPU: time, and whether the answers agree; Markdown.

toolkit dataset build captures --scenes 6 --seed 0
python experiments/benchmarks/gpu.py captures

Wall-clock milliseconds per goal object, the database built, as median over the captures; every capture is estimated
once before the clock starts. Each device has a process of its own. `answers`: share of the objects that the processor
moves that the GPU moves within 1 deg and 5 mm the same, up to a symmetry that the answer names.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pnp import machine, table
from waiting import ROADS, session_of

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.geometry import is_same_motion
from toolkit.types import PoseEstimate

DEVICES = ("cpu", "cuda")
LOFTR = "true masks, LoFTR alone"
_SAME_DEG, _SAME_M = 1.0, 0.005


def measure(device: str, dataset: Path, scenes: int) -> dict[str, Any]:
    """Of every road: milliseconds per goal object of every capture, and the objects' motions by name."""
    captures = [load_capture(folder) for folder in read_dataset(dataset)[:scenes]]
    found: dict[str, Any] = {}
    roads = {**ROADS, LOFTR: {**ROADS["true masks, no refiner"], "matcher": "loftr"}}
    for name, choices in roads.items():
        session = session_of(choices, **({"matcher.device": device} if name == LOFTR else {}))
        times: list[float] = []
        motions: dict[str, Any] = {}
        for warm in (False, True):
            for number, capture in enumerate(captures):
                session.database(capture.current)
                start = time.perf_counter()
                estimates = session.estimate(capture.goal)
                spent = 1e3 * (time.perf_counter() - start)
                if warm:
                    times.append(spent / max(len(estimates), 1))
                    motions |= {
                        f"{number}/{e.goal_object}": alike(e) for e in estimates if e.T_goal_current is not None
                    }
        found[name] = {"ms": times, "motions": motions}
    return found


def alike(estimate: PoseEstimate) -> list[list[list[float]]]:
    """The motions that an answer holds for the same, itself the first."""
    assert estimate.T_goal_current is not None
    found = estimate.T_goal_current[None] if estimate.equivalents is None else estimate.equivalents
    return found.tolist()


def agreement(ours: dict[str, Any], theirs: dict[str, Any]) -> float:
    """Share of our motions that theirs have too."""
    origin, angle = np.zeros(3), float(np.radians(_SAME_DEG))
    same = [
        any(is_same_motion(np.array(a), np.array(theirs[name][0]), origin, angle, _SAME_M) for a in motions)
        for name, motions in ours.items()
        if name in theirs
    ]
    return sum(same) / max(len(ours), 1)


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, help="folder of capture folders, with truth")
    parser.add_argument("--scenes", type=int, default=6, help="how many captures, from the first")
    parser.add_argument("--only", choices=DEVICES, help="measure one device and print JSON")
    options = parser.parse_args()
    if options.only:
        print(json.dumps(measure(options.only, options.dataset, options.scenes)))
        return

    found: dict[str, dict[str, Any]] = {}
    for device in DEVICES:
        command = [sys.executable, __file__, str(options.dataset), "--scenes", str(options.scenes), "--only", device]
        done = subprocess.run(
            command, env={**os.environ, "JAX_PLATFORMS": device}, stdout=subprocess.PIPE, text=True, check=True
        )
        found[device] = json.loads(done.stdout.splitlines()[-1])
    print(f"{torch.cuda.get_device_name(0)} beside {os.cpu_count()} cores; {machine()}\n")
    lines: list[list[str]] = []
    for name, on_cpu in found["cpu"].items():
        on_gpu = found["cuda"][name]
        slow, fast = (float(np.median(side["ms"])) for side in (on_cpu, on_gpu))
        same = agreement(on_cpu["motions"], on_gpu["motions"])
        lines.append([name, f"{slow:.0f}", f"{fast:.0f}", f"{slow / fast:.1f}", f"{100 * same:.0f} %"])
    print(table(["road", "processor, ms", "GPU, ms", "ratio", "answers"], lines))


if __name__ == "__main__":
    main()
