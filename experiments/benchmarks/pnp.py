"""Time and score every PnP solver on the same synthetic problems, side by side; prints Markdown (docs/pnp.md).

python experiments/benchmarks/pnp.py --problems 1000 --seed 0
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn
from scipy.spatial.transform import Rotation

from toolkit.geometry import make_transform, project, rotation_angle, transform_points
from toolkit.stages import PNP, PnP
from toolkit.types import Camera, Correspondences, Failure, Float, PnPSolution

K = np.array([[616.0, 0.0, 320.0], [0.0, 616.0, 240.0], [0.0, 0.0, 1.0]])
CAMERA = Camera(K, np.eye(4), 640, 480)
OBJECT_M, DISTANCE_M, NOISE_PX = 0.10, 0.8, 0.5
REPROJECTION_PX = 3.0
"""Far above the noise, so that all solvers see the same inliers and their poses can be compared."""

OUTLIER_RATES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
SUCCESS_DEG, SUCCESS_MM = 5.0, 20.0


@dataclass(frozen=True)
class Problem:
    """A problem, its true pose (4, 4) T_camera_world, and the object's centre (3,), world, metres."""

    correspondences: Correspondences
    T: Float
    centre: Float


@dataclass(frozen=True)
class Score:
    """Errors (infinite for a Failure) and time of one solver on one problem."""

    degrees: float
    millimetres: float
    milliseconds: float

    @property
    def success(self) -> bool:
        return self.degrees <= SUCCESS_DEG and self.millimetres <= SUCCESS_MM


def make_problem(
    rng: np.random.Generator,
    n: int,
    outliers: float = 0.0,
    noise_px: float = NOISE_PX,
    planar: bool = False,
    camera: Camera = CAMERA,
) -> Problem:
    """A box of points in a random pose before the camera; outliers fall anywhere in the object's image."""
    centre = rng.uniform(-0.5, 0.5, 3)
    R = Rotation.random(rng=rng).as_matrix()
    in_camera = np.array([*rng.uniform(-0.2, 0.2, 2), DISTANCE_M])
    T = make_transform(R, in_camera - R @ centre)
    local = rng.uniform(-OBJECT_M / 2, OBJECT_M / 2, (n, 3)) * ([1, 1, 0] if planar else [1, 1, 1])
    points = local + centre
    pixels, _ = project(camera.K, T, points)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    pixels = pixels + noise_px * rng.standard_normal((n, 2))
    wrong = rng.permutation(n)[: round(outliers * n)]
    pixels[wrong] = rng.uniform(low, high, (len(wrong), 2))
    return Problem(Correspondences(points, pixels, np.ones(n), camera), T, centre)


def pose_error(T: Float, T_true: Float, centre: Float) -> tuple[float, float]:
    """Geodesic angle, degrees, and distance of the object's centre, millimetres."""
    shift = transform_points(T, centre) - transform_points(T_true, centre)
    return float(np.rad2deg(rotation_angle(T[:3, :3].T @ T_true[:3, :3]))), float(1000 * np.linalg.norm(shift))


def timed_solve(solver: PnP, problem: Problem, seed: int, repeats: int) -> tuple[PnPSolution | Failure, float]:
    """The answer, and the median time in milliseconds of `repeats` solves."""
    times: list[float] = []
    answers: list[PnPSolution | Failure] = []
    for _ in range(repeats):
        start = time.perf_counter()
        answers.append(solver.solve(problem.correspondences, seed))
        times.append(1000 * (time.perf_counter() - start))
    return answers[0], float(np.median(times))


def median_interval(values: Sequence[float]) -> str:
    """Median with its 95 % bootstrap interval."""
    data = np.asarray(values)
    resampled = np.random.default_rng(0).choice(data, (2000, len(data)))
    # Order statistics, not interpolation: an error may be infinite.
    low, high = np.quantile(np.median(resampled, axis=1), [0.025, 0.975], method="nearest")
    return f"{np.median(data):.3f} [{low:.3f}, {high:.3f}]"


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def machine() -> str:
    """Processor, cores and library versions."""
    cpuinfo = Path("/proc/cpuinfo")
    models = [line for line in cpuinfo.read_text().splitlines() if "model name" in line] if cpuinfo.exists() else []
    cpu = models[0].split(":")[1].strip() if models else platform.processor()
    libraries = ("jax", "opencv-python-headless", "poselib", "numpy")
    return f"{cpu}, {len(models)} cores; " + ", ".join(f"{name} {version(name)}" for name in libraries)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=3, help="timed solves of every problem; the median counts")
    parser.add_argument("--planar", action="store_true", help="points on one face of the object")
    options = parser.parse_args(arguments)

    solvers = {name: PNP.create(name, {"reprojection_px": REPROJECTION_PX}) for name in PNP.names()}
    rates = [OUTLIER_RATES[k % len(OUTLIER_RATES)] for k in range(options.problems)]
    problems: list[Problem] = []
    for k, rate in enumerate(rates):
        rng = np.random.default_rng(np.random.SeedSequence([options.seed, k]))
        problems.append(make_problem(rng, int(rng.integers(30, 301)), rate, planar=options.planar))
    first_call = {name: timed_solve(solver, problems[0], 0, 1)[1] for name, solver in solvers.items()}
    by_size = {max(1, len(p.correspondences) // 64): p for p in problems}
    for problem in by_size.values():  # every shape is compiled before the clock starts
        for solver in solvers.values():
            solver.solve(problem.correspondences, 0)

    scores: dict[str, list[Score]] = {name: [] for name in solvers}
    poses: dict[str, list[Float | None]] = {name: [] for name in solvers}
    columns = (*Progress.get_default_columns()[:-1], MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        for k, problem in progress.track(list(enumerate(problems)), description="solving"):
            for name, solver in solvers.items():
                answer, milliseconds = timed_solve(solver, problem, k, options.repeats)
                T = answer.T_camera_world if isinstance(answer, PnPSolution) else None
                errors = (np.inf, np.inf) if T is None else pose_error(T, problem.T, problem.centre)
                scores[name].append(Score(*errors, milliseconds))
                poses[name].append(T)

    shown = sorted(set(rates))
    print(f"{options.problems} problems, seed {options.seed}; {machine()}\n")
    accuracy: list[list[str]] = []
    for rate in shown:
        for name in solvers:
            group = [score for score, r in zip(scores[name], rates, strict=True) if r == rate]
            rotation, translation = ([getattr(s, key) for s in group] for key in ("degrees", "millimetres"))
            success = f"{100 * np.mean([s.success for s in group]):.1f}"
            row = [f"{rate:.0%}", name, median_interval(rotation), median_interval(translation), success]
            accuracy.append([*row, f"{np.median([s.milliseconds for s in group]):.1f}"])
    print(table(["outliers", "solver", "rotation, deg", "translation, mm", "success, %", "time, ms"], accuracy))

    agreement: list[list[str]] = []
    for rate in shown:
        pairs = [
            (ours, theirs, problem)
            for ours, theirs, problem, r in zip(poses["jax_ransac"], poses["poselib"], problems, rates, strict=True)
            if r == rate
        ]
        solved = [(a, b, p) for a, b, p in pairs if a is not None and b is not None]
        same_verdict = np.mean([(a is None) == (b is None) for a, b, _ in pairs])
        differences = np.array([pose_error(a, b, p.centre) for a, b, p in solved]).reshape(-1, 2)
        quantiles = np.quantile(differences, [0.5, 0.99, 1.0], axis=0).T
        cells = [" / ".join(f"{value:.1e}" for value in column) for column in quantiles]
        agreement.append([f"{rate:.0%}", *cells, f"{100 * same_verdict:.1f}"])
    print("jax_ransac against poselib, distance between their poses, median / p99 / largest\n")
    print(table(["outliers", "rotation, deg", "translation, mm", "same verdict, %"], agreement))

    timing: list[list[str]] = []
    for name in solvers:
        times = [score.milliseconds for score in scores[name]]
        p90 = f"{np.quantile(times, 0.9):.1f}"
        success = f"{100 * np.mean([s.success for s in scores[name]]):.1f}"
        timing.append([name, median_interval(times), p90, success, f"{first_call[name] / 1000:.2f}"])
    print(table(["solver", "median, ms", "p90, ms", "success, %", "first call, s"], timing))


if __name__ == "__main__":
    main()
