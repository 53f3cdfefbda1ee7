"""Fit how far `perch` trusts its placements on folders of captures, and show on others how reliable that is.

toolkit dataset build train/wild --scenes 20 --seed 31 --set track=wild          (and crowded, d435, clean)
toolkit dataset build test/wild --scenes 12 --seed 21 --set track=wild --objects ../shared/objects
python experiments/benchmarks/trust.py --train train/* --test test/*

Masks are the pipeline's own. A placement is right if its segment is a labelled object's, by an IoU of 0.5, and its
motion, once refined, is that object's within 5 degrees and 2 cm, symmetries considered. The rest is wrong, clutter too.
"""

from __future__ import annotations

import argparse
import pickle
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from sklearn.linear_model import LogisticRegression

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.harness.experiment import expand, load_experiment
from toolkit.harness.worker import make_runner
from toolkit.perception.explanation import ExplainTask, Explanation, Placement
from toolkit.perception.stages import Explainer
from toolkit.results.metrics import assign_goal_objects, pose_error
from toolkit.types import Float

BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 1.0)
SURE = 0.5
WRONG = 8
"""An answer that is wrong and sure costs as much as eight right ones that are withheld."""


class Listener(Explainer):
    """Passes an explainer's answer on and remembers it."""

    def __init__(self, inner: Explainer) -> None:
        self.inner = inner
        self.placements: tuple[Placement, ...] = ()

    def explain(self, task: ExplainTask) -> Explanation | None:
        """Ask the explainer that is listened to."""
        found = self.inner.explain(task)
        self.placements = () if found is None else found.placements
        return found


def samples(folder: Path) -> list[tuple[dict[str, float], float, bool, str]]:
    """What every placement of a capture is judged by, its final confidence, whether it is right, and what it is."""
    pipeline = make_runner(expand(load_experiment("estimate", {}))[0], None).pipeline
    listener = Listener(pipeline.stages.explainer)
    pipeline = replace(pipeline, stages=replace(pipeline.stages, explainer=listener))
    capture = load_capture(folder)
    assert capture.truth is not None and capture.goal.true_masks is not None
    estimates = pipeline.run(capture)
    objects = assign_goal_objects([e.segment for e in estimates], capture.goal.true_masks)
    truth = {number: capture.truth[i] for i, number in objects.items() if i in capture.truth}
    rows: list[tuple[dict[str, float], float, bool, str]] = []
    for number, (placement, estimate) in enumerate(zip(listener.placements, estimates, strict=False)):
        if estimate.T_goal_current is None:
            continue
        right = number in truth and pose_error(estimate.T_goal_current, truth[number]).success_sym
        name = truth[number].model.name if number in truth else "no object"
        confidence = 0.0 if estimate.confidence is None else estimate.confidence
        rows.append(
            (dict(placement.judged), confidence / max(placement.trust, 1e-9), right, f"{folder} {number} {name}")
        )
    return rows


def collect(folders: list[Path]) -> list[tuple[dict[str, float], float, bool, str]]:
    """All placements of folders of captures."""
    captures = [capture for folder in folders for capture in read_dataset(folder)]
    parts = Parallel(n_jobs=-1, verbose=5)(delayed(samples)(capture) for capture in captures)
    return [row for part in parts for row in part]


def main() -> None:
    """Print weights, bias, the reliability table, and what is wrong among the surest."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--train", type=Path, nargs="+", required=True)
    parser.add_argument("--test", type=Path, nargs="+", required=True)
    parser.add_argument("--keep", type=Path, help="file to keep the samples in")
    options = parser.parse_args()
    train, test = collect(options.train), collect(options.test)
    if options.keep:
        options.keep.write_bytes(pickle.dumps((train, test)))
    names = list(train[0][0])
    X, y = table(train, names)
    model = LogisticRegression(C=1, max_iter=5000, class_weight={0: WRONG, 1: 1}).fit(X, y)
    print(dict(zip(names, model.coef_[0].round(2).tolist(), strict=True)), "bias", model.intercept_[0].round(2))
    X, y = table(test, names)
    p = model.predict_proba(X)[:, 1] * np.array([row[0]["whole"] * row[1] for row in test])
    print("| confidence | placements | mean confidence | right |\n| --- | --- | --- | --- |")
    for low, high in pairwise(BINS):
        rows = (p >= low) & (p < high)
        if rows.any():
            print(f"| {low:.2f} to {high:.2f} | {rows.sum()} | {p[rows].mean():.2f} | {y[rows].mean():.2f} |")
    for i in np.argsort(-p):
        if not y[i] and p[i] > SURE:
            print(f"{p[i]:.2f}", test[i][3], {k: round(v, 2) for k, v in test[i][0].items()})


def table(rows: list[tuple[dict[str, float], float, bool, str]], names: list[str]) -> tuple[Float, Float]:
    """Features (N, F) and outcomes (N,)."""
    return np.array([[row[0][name] for name in names] for row in rows]), np.array([float(row[2]) for row in rows])


if __name__ == "__main__":
    main()
