"""Fit how far `perch` trusts its placements on folders of captures, and show on others how reliable that is.

toolkit dataset build train/wild --scenes 20 --seed 31 --set track=wild          (and crowded, d435, clean)
toolkit dataset build test/wild --scenes 12 --seed 21 --set track=wild --objects ../shared/objects
python experiments/benchmarks/trust.py --train train/* --test test/*

Masks are the pipeline's own. A placement is right if its segment is a labelled object's, by an IoU of 0.5, and its
motion, once refined, is that object's within 5 degrees and 2 cm, symmetries considered. The rest is wrong, clutter too.
The last table says how often motions are right that PnP on matches leads to as well, within 5 degrees and 2 cm.
"""

from __future__ import annotations

import argparse
import pickle
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from sklearn.linear_model import LogisticRegression

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.geometry import is_same_motion
from toolkit.harness.experiment import expand, load_experiment
from toolkit.harness.worker import make_runner
from toolkit.perception.explanation import ExplainTask, Explanation, Placement
from toolkit.perception.fusion import RefineTask
from toolkit.perception.stages import Explainer, Refiner
from toolkit.results.metrics import assign_goal_objects, pose_error
from toolkit.types import Failure, Float, Refined

BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 1.0)
SURE = 0.5
WRONG = 8
"""An answer that is wrong and sure costs as much as eight right ones that are withheld."""


SAME_RAD, SAME_M = np.radians(5), 0.02


@dataclass(frozen=True)
class Sample:
    """One placement.

    Attributes:
        judged: what it is judged by.
        refined: the refiner's own confidence.
        right: whether it is.
        matched: whether matches lead to the same motion; None where they lead nowhere.
        what: where it is from.
    """

    judged: dict[str, float]
    refined: float
    right: bool
    matched: bool | None
    what: str


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


class RefinerListener(Refiner):
    """Passes a refiner's answers on and remembers, by goal object, whether matches lead to them as well."""

    def __init__(self, inner: Refiner) -> None:
        self.inner = inner
        self.matched: list[bool | None] = []

    def refine(self, task: RefineTask) -> Refined | Failure | None:
        """Ask the refiner that is listened to."""
        refined = self.inner.refine(task)
        starts = [start.T_goal_current for start in task.starts if start.independent]
        found = refined.T_goal_current if isinstance(refined, Refined) else None
        model = task.models.get(task.instance)
        center = np.zeros(3) if isinstance(model, Failure) else model.center
        same = [found is not None and is_same_motion(found, T, center, SAME_RAD, SAME_M) for T in starts]
        self.matched.append(any(same) if same else None)
        return refined

    def verify(self, task: RefineTask) -> float | None:
        """As the refiner that is listened to."""
        return self.inner.verify(task)


def samples(folder: Path) -> list[Sample]:
    """The placements of a capture that end as a motion."""
    pipeline = make_runner(expand(load_experiment("estimate", {}))[0], None).pipeline
    explainer, refiner = Listener(pipeline.stages.explainer), RefinerListener(pipeline.stages.refiner)
    pipeline = replace(pipeline, stages=replace(pipeline.stages, explainer=explainer, refiner=refiner))
    capture = load_capture(folder)
    assert capture.truth is not None and capture.goal.true_masks is not None
    estimates = pipeline.run(capture)
    objects = assign_goal_objects([e.segment for e in estimates], capture.goal.true_masks)
    truth = {number: capture.truth[i] for i, number in objects.items() if i in capture.truth}
    rows: list[Sample] = []
    for number, (placement, estimate) in enumerate(zip(explainer.placements, estimates, strict=False)):
        if estimate.T_goal_current is None:
            continue
        right = number in truth and pose_error(estimate.T_goal_current, truth[number]).success_sym
        name = truth[number].model.name if number in truth else "no object"
        refined = (estimate.confidence or 0.0) / max(placement.trust, 1e-9)
        rows.append(
            Sample(dict(placement.judged), refined, right, refiner.matched[number], f"{folder} {number} {name}")
        )
    return rows


def collect(folders: list[Path]) -> list[Sample]:
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
    names = list(train[0].judged)
    X, y = table(train, names)
    model = LogisticRegression(C=1, max_iter=5000, class_weight={0: WRONG, 1: 1}).fit(X, y)
    print(dict(zip(names, model.coef_[0].round(2).tolist(), strict=True)), "bias", model.intercept_[0].round(2))
    X, y = table(test, names)
    p = model.predict_proba(X)[:, 1] * np.array([row.judged["whole"] * row.refined for row in test])
    print("| confidence | placements | mean confidence | right |\n| --- | --- | --- | --- |")
    for low, high in pairwise(BINS):
        rows = (p >= low) & (p < high)
        if rows.any():
            print(f"| {low:.2f} to {high:.2f} | {rows.sum()} | {p[rows].mean():.2f} | {y[rows].mean():.2f} |")
    for i in np.argsort(-p):
        if not y[i] and p[i] > SURE:
            print(f"{p[i]:.2f}", test[i].what, {k: round(v, 2) for k, v in test[i].judged.items()})
    print("| matches lead | placements | right |\n| --- | --- | --- |")
    for matched, words in ((True, "there too"), (False, "elsewhere"), (None, "nowhere")):
        group = [row.right for row in test if row.matched is matched]
        print(f"| {words} | {len(group)} | {sum(group)} |")


def table(rows: list[Sample], names: list[str]) -> tuple[Float, Float]:
    """Features (N, F) and outcomes (N,)."""
    return np.array([[row.judged[name] for name in names] for row in rows]), np.array(
        [float(row.right) for row in rows]
    )


if __name__ == "__main__":
    main()
