"""What the compiled kernels cost on one real scene, and what the machine could do; prints Markdown.

toolkit dataset build captures --scenes 6 --seed 0
python experiments/benchmarks/kernels.py captures/000001

Every kernel is timed with the arguments of its calls in that scene: processor time, median of `--repeats`. Operations
and bytes are XLA's own count for the compiled program. The machine's rates are those of a product of matrices and of a
copy, measured beside them.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import jax
import numpy as np
from pnp import machine, table

from toolkit.data.bop import load_capture
from toolkit.harness.session import Session
from toolkit.perception.explainers.searching import scores
from toolkit.perception.pnp import jax_joint
from toolkit.perception.refiners.comparing import compare

_IN_FLOAT64 = "motions from two matches (pnp)"
KERNELS = {
    "places of an object (explainer)": (scores, "_score"),
    _IN_FLOAT64: (jax_joint, "search_planar"),
    "turns all around (refiner)": (compare, "score_poses"),
    "refinement of the best (refiner)": (compare, "align"),
}


def recorded(kernel: Callable[..., Any], calls: list[tuple[Any, ...]]) -> Callable[..., Any]:
    """The kernel, keeping what it is called with."""

    def call(*arguments: Any) -> Any:
        calls.append(arguments)
        return kernel(*arguments)

    return call


def milliseconds(work: Callable[[], Any], repeats: int) -> float:
    """Median processor time."""
    times: list[float] = []
    for _ in range(repeats + 1):
        start = time.process_time()
        jax.block_until_ready(work())
        times.append(1e3 * (time.process_time() - start))
    return float(np.median(times[1:]))


def line(name: str, kernel: Any, calls: list[tuple[Any, ...]], objects: int, repeats: int) -> list[str]:
    """A kernel's row: calls and milliseconds per object, and operations and bytes of its middle call."""
    arguments = calls[len(calls) // 2]
    with jax.enable_x64(name == _IN_FLOAT64):
        cost = kernel.lower(*arguments).compile().cost_analysis()
        each = milliseconds(lambda: kernel(*arguments), repeats)
    rate = cost["flops"] / each / 1e6
    return [
        name,
        f"{len(calls) / objects:.1f}",
        f"{each:.2f}",
        f"{each * len(calls) / objects:.0f}",
        f"{cost['flops'] / 1e6:.1f}",
        f"{cost['bytes accessed'] / 1e6:.1f}",
        f"{rate:.1f}",
    ]


def limits(repeats: int) -> list[str]:
    """What this processor does at best, in one thread."""
    a, large = np.random.default_rng(0).random((1024, 1024), np.float32), np.zeros(1 << 26, np.uint8)
    operations, moved = 2 * len(a) ** 3, 2 * large.size
    return [
        f"{operations / milliseconds(lambda: a @ a, repeats) / 1e6:.0f} GFlop/s in a product of matrices",
        f"{moved / milliseconds(large.copy, repeats) / 1e6:.1f} GB/s in a copy",
    ]


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--repeats", type=int, default=9)
    options = parser.parse_args()

    cv2.setNumThreads(1)
    kernels = {name: getattr(module, attribute) for name, (module, attribute) in KERNELS.items()}
    calls: dict[str, list[tuple[Any, ...]]] = {name: [] for name in KERNELS}
    for name, (module, attribute) in KERNELS.items():
        setattr(module, attribute, recorded(kernels[name], calls[name]))
    capture, session = load_capture(options.capture), Session("estimate")
    session.database(capture.current)
    objects = len([e for e in session.estimate(capture.goal) if e.instance is not None])
    header = ["kernel", "calls per object", "call, ms", "object, ms", "MFlop", "MB", "GFlop/s"]
    print(f"{objects} goal objects; {machine()}; {', '.join(limits(options.repeats))}\n")
    print(table(header, [line(n, kernels[n], calls[n], objects, options.repeats) for n in KERNELS if calls[n]]))


if __name__ == "__main__":
    main()
