"""What is wrong with the depth of captures, in figures: real sensors' beside rendered ones'.

toolkit dataset build clean --scenes 4 --set views=4
toolkit dataset build realsense --scenes 4 --set track=realsense --set background=true --set views=4
python experiments/benchmarks/depth_noise.py ../shared/real clean realsense

Prints one line per capture of a folder that is no dataset of ours, one per dataset otherwise.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.types import Float, Frame

_BLOCK_PX = 24
_FLAT_SHARE = 0.3
"""The flattest part of the blocks is taken to be flat indeed."""

_REACH_PX = 3
_JUMP_M = 0.05
_FURTHEST_M = 1.5
"""Further away, noise alone is a jump."""


@dataclass(frozen=True)
class Figures:
    """Of one frame.

    Attributes:
        noise_mm: deviation from a plane within a block, scaled to 1 m by the square of depth.
        correlation: of that deviation between pixels that are neighbours, and between those that are four apart.
        invalid: share of pixels that were not measured.
        invalid_inside: the same away from the picture's border.
        mixed: share of the pixels between two surfaces whose depth is neither's.
        lost: share of the pixels between two surfaces that were not measured.
    """

    noise_mm: float
    correlation: tuple[float, float]
    invalid: float
    invalid_inside: float
    mixed: float
    lost: float


def measure(depth: Float) -> Figures:
    """Figures of an (H, W) depth image in metres."""
    blocks = _residuals(depth)
    spread = np.array([block.std() for block in blocks])
    flat = np.argsort(spread)[: max(1, int(_FLAT_SHARE * len(blocks)))]
    kept = [blocks[i] for i in flat]
    inside = depth[depth.shape[0] // 10 : -depth.shape[0] // 10, depth.shape[1] // 10 : -depth.shape[1] // 10]
    mixed, lost = _edges(depth)
    return Figures(
        1e3 * float(np.median(spread[flat])),
        (_correlation(kept, 1), _correlation(kept, 4)),
        float((depth == 0).mean()),
        float((inside == 0).mean()),
        mixed,
        lost,
    )


def _residuals(depth: Float) -> list[Float]:
    """Deviation of 1/z from a plane's, of blocks that are measured throughout: 1/z of a plane is linear in pixels."""
    y, x = np.mgrid[:_BLOCK_PX, :_BLOCK_PX].reshape(2, -1)
    A = np.stack([x, y, np.ones_like(x)], axis=1).astype(np.float64)
    project = np.eye(len(A)) - A @ np.linalg.pinv(A)
    found: list[Float] = []
    for top in range(0, depth.shape[0] - _BLOCK_PX, _BLOCK_PX):
        for left in range(0, depth.shape[1] - _BLOCK_PX, _BLOCK_PX):
            block = depth[top : top + _BLOCK_PX, left : left + _BLOCK_PX].astype(np.float64)
            if (block > 0).all() and block.max() < _FURTHEST_M:
                found.append((project @ (1 / block).ravel()).reshape(block.shape))
    return found or [np.zeros((_BLOCK_PX, _BLOCK_PX))]


def _correlation(blocks: list[Float], step: int) -> float:
    a = np.concatenate([block[:, :-step].ravel() for block in blocks])
    b = np.concatenate([block[:, step:].ravel() for block in blocks])
    return float(np.corrcoef(a, b)[0, 1]) if a.std() > 0 else 0.0


def _edges(depth: Float) -> tuple[float, float]:
    """Over the pixels that have measured depth on both sides, more than a jump apart: shares of mixed and lost ones."""
    mixed = lost = total = 0
    for image in (depth, depth.T):
        left, right = image[:, : -2 * _REACH_PX], image[:, 2 * _REACH_PX :]
        middle = image[:, _REACH_PX:-_REACH_PX]
        low, high = np.minimum(left, right), np.maximum(left, right)
        edge = (low > 0) & (high - low > _JUMP_M) & (high < _FURTHEST_M)
        part = (middle - low) / np.maximum(high - low, 1e-6)
        total += int(edge.sum())
        lost += int((edge & (middle == 0)).sum())
        mixed += int((edge & (middle > 0) & (part > 0.2) & (part < 0.8)).sum())
    return mixed / max(total, 1), lost / max(total, 1)


def mean(figures: list[Figures]) -> Figures:
    """Over frames."""
    values = np.array([[f.noise_mm, *f.correlation, f.invalid, f.invalid_inside, f.mixed, f.lost] for f in figures])
    n, near, far, invalid, inside, mixed, lost = values.mean(axis=0).tolist()
    return Figures(n, (near, far), invalid, inside, mixed, lost)


def main() -> None:
    """Measure folders of captures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", type=Path, nargs="+")
    options = parser.parse_args()
    print("| captures | noise, mm at 1 m | correlation 1 px, 4 px | not measured | inside | edges: mixed | lost |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for dataset in options.datasets:
        frames: dict[str, list[Frame]] = {}
        for folder in read_dataset(dataset):
            name = dataset.name if (dataset / "dataset.json").exists() else folder.name
            frames.setdefault(name, []).extend(load_capture(folder).current)
        for name, own in frames.items():
            f = mean([measure(_at_640(frame)) for frame in own])
            print(
                f"| {name} | {f.noise_mm:.2f} | {f.correlation[0]:.2f}, {f.correlation[1]:.2f} | {f.invalid:.1%} | "
                f"{f.invalid_inside:.1%} | {f.mixed:.0%} | {f.lost:.0%} |"
            )


def _at_640(frame: Frame) -> Float:
    """Depth as a picture of 640 pixels, so that distances in pixels compare."""
    assert frame.depth is not None
    size = (640, round(640 * frame.camera.height / frame.camera.width))
    return np.asarray(cv2.resize(frame.depth, size, interpolation=cv2.INTER_NEAREST))


if __name__ == "__main__":
    main()
