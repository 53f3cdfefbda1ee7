"""Fit when two pieces of depth that touch are one object, on folders of captures, and show on others how often it errs.

toolkit dataset build train/wild --scenes 20 --seed 31 --set track=wild          (and crowded, d435, clean)
toolkit dataset build test/wild --scenes 12 --seed 21 --set track=wild --objects ../shared/objects
python experiments/benchmarks/joins.py --train train/* --test test/*

Two objects taken for one count four times: one taken for two is mended later where its parts move alike.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from sklearn.linear_model import LogisticRegression

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.perception.tabletop.joining import borders
from toolkit.perception.tabletop.pieces import cut_pieces
from toolkit.perception.tabletop.relief import relief
from toolkit.perception.tabletop.table import find_table
from toolkit.types import Float

MIN_HEIGHT_M = 0.0015
PURE = 0.7
"""Pieces of which less lies on one object teach nothing about where objects end."""

LEAST_M2, LEAST_SHARE = 3e-4, 0.04
LEVELS = (0.5, 0.7, 0.8, 0.9)


def samples(folder: Path) -> list[list[float]]:
    """Rows of features and whether the two pieces are one object, for all pairs of a capture that touch."""
    frames = load_capture(folder).current
    table = find_table(frames)
    reliefs = [relief(frame, plane, table, MIN_HEIGHT_M) for frame, plane in table.seen()]
    voxels, pieces = cut_pieces(reliefs, table)
    true = np.concatenate([_owners(r.frame.true_masks or {}, r.things) for r in reliefs])
    of_pixel = pieces.of_voxel[pieces.voxel_of_pixel]
    count = int(pieces.of_voxel.max(initial=-1)) + 1
    owner, purity, area = np.full(count, -1), np.zeros(count), np.zeros(count)
    for k in range(count):
        ids, pixels = np.unique(true[of_pixel == k], return_counts=True)
        owner[k], purity[k] = ids[pixels.argmax()], pixels.max() / pixels.sum()
        area[k] = (pieces.of_voxel == k).sum() * voxels.cell**2
    rows: list[list[float]] = []
    for (i, j), (_, features) in borders(pieces).items():
        small, large = sorted((area[i], area[j]))
        if min(owner[i], owner[j]) < 0 or min(purity[i], purity[j]) < PURE:
            continue
        if small > max(LEAST_M2, LEAST_SHARE * large):
            rows.append([*features, float(owner[i] == owner[j])])
    return rows


def _owners(masks: object, things: np.ndarray) -> np.ndarray:
    owner = np.full(things.shape, -1)
    assert isinstance(masks, dict)
    for number, mask in masks.items():
        owner[mask] = number
    return owner[things]


def collect(folders: list[Path]) -> tuple[Float, Float]:
    """Features (N, F) and outcomes (N,)."""
    captures = [capture for folder in folders for capture in read_dataset(folder)]
    parts = Parallel(n_jobs=-1)(delayed(samples)(capture) for capture in captures)
    table = np.array([row for part in parts for row in part])
    return table[:, :-1], table[:, -1]


def main() -> None:
    """Print weights, bias and the errors at several levels."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--train", type=Path, nargs="+", required=True)
    parser.add_argument("--test", type=Path, nargs="+", required=True)
    options = parser.parse_args()
    X, y = collect(options.train)
    model = LogisticRegression(C=10, class_weight={0: 4, 1: 1}, max_iter=5000).fit(X, y)
    print("weights", model.coef_[0].round(3).tolist(), "bias", model.intercept_[0].round(3))
    print("| captures | probability | one object, parted | two objects, joined |\n| --- | --- | --- | --- |")
    for folder in (*options.train, *options.test):
        X, y = collect([folder])
        p = model.predict_proba(X)[:, 1]
        for level in LEVELS:
            parted, fused = int(((y == 1) & (p <= level)).sum()), int(((y == 0) & (p > level)).sum())
            print(f"| {folder} | {level} | {parted} of {int(y.sum())} | {fused} of {int((1 - y).sum())} |")


if __name__ == "__main__":
    main()
