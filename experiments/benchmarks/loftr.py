"""Time the toolkit's LoFTR and stock kornia's on the same pairs, side by side, and compare matches; prints Markdown.

python experiments/benchmarks/loftr.py --crop 320 --candidates 8 --objects 3 --repeats 3

Weights are random and of the official size, with every mutual match let through: what is compared is the work, and
whether it is the same. One goal object is matched to all candidates; the database serves `--objects` goal objects.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from kornia.feature import LoFTR
from scipy.ndimage import gaussian_filter

from toolkit.perception.matchers.loftr import LoftrConfig, LoftrMatcher
from toolkit.types import Crop, Matches


def make_crops(rng: np.random.Generator, size: int, count: int) -> list[Crop]:
    """One textured disc seen `count` times, each a little moved and noisy."""
    big = np.stack([gaussian_filter(rng.standard_normal((size + 40, size + 40)), 3) for _ in range(3)], axis=-1)
    big = 128 + 45 * big / big.std()
    y, x = np.indices((size, size))
    mask = np.hypot(x - size / 2, y - size / 2) < 0.45 * size
    crops: list[Crop] = []
    for _ in range(count):
        dx, dy = rng.integers(0, 40, 2)
        image = big[dy : dy + size, dx : dx + size] + rng.normal(0, 3, (size, size, 3))
        crops.append(Crop(np.where(mask[..., None], image, 0).clip(0, 255).astype(np.uint8), mask, 1.0, np.zeros(2)))
    return crops


def stock(model: LoFTR, goal: Crop, candidates: list[Crop]) -> list[Matches]:
    """Kornia as its documentation has it: one call a pair, both images, float32."""
    found: list[Matches] = []
    with torch.inference_mode():
        for candidate in candidates:
            pair: dict[str, Any] = {f"image{i}": gray(crop) for i, crop in enumerate((goal, candidate))}
            out = model(pair)
            xy = [out[f"keypoints{i}"].numpy().astype(np.float64) - 0.5 for i in (0, 1)]
            kept = on(goal, xy[0]) & on(candidate, xy[1])
            found.append(Matches(xy[0][kept], xy[1][kept], out["confidence"].numpy().astype(np.float64)[kept]))
    return found


def gray(crop: Crop) -> torch.Tensor:
    """(1, 1, S, S) as the matcher makes it."""
    import cv2

    return torch.from_numpy(cv2.cvtColor(crop.image, cv2.COLOR_RGB2GRAY)).float()[None, None] / 255


def on(crop: Crop, xy: np.ndarray) -> np.ndarray:
    """Whether positions lie on the mask."""
    x, y = np.rint(xy).astype(int).clip(0, len(crop.mask) - 1).T
    return crop.mask[y, x]


def timed(work: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Median seconds, and the last answer; one run to warm up."""
    answer = work()
    seconds: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        answer = work()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds)), answer


def agreement(ours: list[Matches], theirs: list[Matches]) -> tuple[float, float]:
    """Share of their matches that we have too (same cell, within a pixel), and the median distance of those, pixels."""
    shared = total = 0
    gaps: list[float] = []
    for a, b in zip(ours, theirs, strict=True):
        own = {tuple(xy): other for xy, other in zip(np.rint(a.query_xy).tolist(), a.reference_xy, strict=True)}
        total += len(b)
        for xy, other in zip(np.rint(b.query_xy).tolist(), b.reference_xy, strict=True):
            gap = float(np.linalg.norm(own[tuple(xy)] - other)) if tuple(xy) in own else np.inf
            shared += gap < 1.0
            gaps += [gap] if gap < 1.0 else []
    return shared / max(total, 1), float(np.median(gaps)) if gaps else float("nan")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--crop", type=int, default=320)
    parser.add_argument("--candidates", type=int, default=8)
    parser.add_argument("--objects", type=int, default=3, help="goal objects a database serves")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(0)
    goal, *candidates = make_crops(np.random.default_rng(0), options.crop, options.candidates + 1)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "random.ckpt"
        network = LoFTR(pretrained=None)
        torch.save({"state_dict": network.state_dict()}, file)
        network.coarse_matching.thr = 0.0
        network.eval()
        theirs_s, theirs = timed(lambda: stock(network, goal, candidates), options.repeats)
        lines = [f"| kornia, pair by pair, float32 | {1000 * theirs_s:.0f} | 1.0 | {1000 * theirs_s:.0f} | 1.0 | | |"]
        for precision in ("float32", "bfloat16"):
            config = LoftrConfig(
                weights="outdoor", file=file, crop_size=options.crop, threshold=0.0, precision=precision
            )
            matcher = LoftrMatcher(config)
            database_s, features = timed(lambda m=matcher: m.extract(candidates), options.repeats)
            alone_s, ours = timed(lambda m=matcher, f=features: m.match(m.extract([goal])[0], f), options.repeats)
            shared_s = alone_s + database_s / options.objects
            same, gap = agreement(ours, theirs)
            lines.append(
                f"| toolkit, {precision} | {1000 * alone_s:.0f} | {theirs_s / alone_s:.1f} | {1000 * shared_s:.0f} "
                f"| {theirs_s / shared_s:.1f} | {100 * same:.1f} % | {gap:.3f} |"
            )
    print(
        f"{options.candidates} candidates of {options.crop} px, full-size LoFTR, {platform.machine()}, "
        f"{options.threads} thread(s), torch {torch.__version__}; medians of {options.repeats}.\n"
    )
    print(
        f"| | per object, ms | times faster | with its share of the database ({options.objects} objects), ms "
        "| times faster | matches shared | median gap, px |\n| --- | --- | --- | --- | --- | --- | --- |"
    )
    print("\n".join(lines))


if __name__ == "__main__":
    main()
