"""How far camera poses that are a little off are brought together by each registration, in what time; prints Markdown.

The stated poses of a dataset without noise get the d435 track's pose errors.

toolkit dataset build captures --objects ../shared/objects --scenes 20 --seed 0
python experiments/benchmarks/registration.py captures
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from toolkit.data.bop import load_capture
from toolkit.data.cameras import jitter
from toolkit.data.dataset import read_dataset
from toolkit.geometry import invert, transform_points
from toolkit.stages import REGISTRATIONS
from toolkit.types import Frame

PLACES = np.array([[0.2 * np.cos(a), 0.2 * np.sin(a), 0.04] for a in np.linspace(0, 2 * np.pi, 8)[:-1]])
"""Points of the scene, metres."""


def disagreement(frames: Sequence[Frame], goal: Frame, true: Sequence[Frame], true_goal: Frame) -> float:
    """Millimetres by which the frames and the goal place a point differently, on average."""

    def placed(frame: Frame, truth: Frame) -> np.ndarray:
        return transform_points(frame.camera.T_world_camera @ invert(truth.camera.T_world_camera), PLACES)

    there = placed(goal, true_goal)
    return 1e3 * float(np.mean([np.linalg.norm(placed(*p) - there, axis=1) for p in zip(frames, true, strict=True)]))


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    options = parser.parse_args()
    errors: dict[str, list[float]] = {name: [] for name in REGISTRATIONS.names()}
    times: dict[str, list[float]] = {name: [] for name in REGISTRATIONS.names()}
    for number, folder in enumerate(track(read_dataset(options.dataset), console=Console(stderr=True))):
        capture = load_capture(folder)
        rng = np.random.default_rng(number)
        stated = [replace(f, camera=jitter(f.camera, rng)) for f in (*capture.current, capture.goal)]
        for name in REGISTRATIONS.names():
            stage = REGISTRATIONS.create(name)
            start = time.perf_counter()
            frames = stage.register(stated[:-1])
            goal = stage.locate(stated[-1], frames)
            times[name].append(1e3 * (time.perf_counter() - start))
            errors[name].append(disagreement(frames, goal, capture.current, capture.goal))
    print("| registration | disagreement, mm, median | p90 | time per scene, ms |\n| --- | --- | --- | --- |")
    for name, own in errors.items():
        print(f"| {name} | {np.median(own):.2f} | {np.quantile(own, 0.9):.2f} | {np.median(times[name]):.0f} |")


if __name__ == "__main__":
    main()
