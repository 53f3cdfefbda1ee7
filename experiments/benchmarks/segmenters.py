"""Score and time segmenters on folders of captures with true masks; prints Markdown.

python experiments/benchmarks/segmenters.py DATASET... --scenes 20
python experiments/benchmarks/segmenters.py ../shared/real --each --images goal --explained

With `--explained` the goal's masks are those that the default pipeline ends with. Boundary F is that of Xie et al.
("The best of both modes", CoRL 2019): boundary pixels within 0.3 % of the image's diagonal of each other agree, and
precision and recall are over all objects of an image, each assigned to one segment.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from scipy.optimize import linear_sum_assignment

from toolkit.data.bop import load_capture
from toolkit.errors import ToolkitError
from toolkit.harness.experiment import expand, load_experiment
from toolkit.harness.worker import make_runner
from toolkit.progress import Progress
from toolkit.results.stats import bootstrap_interval, wilson_interval
from toolkit.stages import SEGMENTERS
from toolkit.types import Capture, Frame, Mask, Segment

MATCH_IOU = 0.5
BOUNDARY = 0.003
EXPLAINED = "explained"
SMALLEST_PX = 60
"""Objects with fewer visible pixels are not asked for; a segment on one counts as false all the same."""


@dataclass
class Tally:
    """What one segmenter did on one kind of image.

    Attributes:
        objects: true ones.
        segments: found ones.
        refused: images that it does not segment.
        ious: one per matched object.
        scenes: the scene of each of those.
        boundaries: boundary F, one per image.
        milliseconds: one per image.
    """

    objects: int = 0
    segments: int = 0
    refused: int = 0
    ious: list[float] = field(default_factory=list)
    scenes: list[int] = field(default_factory=list)
    boundaries: list[float] = field(default_factory=list)
    milliseconds: list[float] = field(default_factory=list)

    def row(self, name: str, kind: str) -> str:
        """One Markdown row."""
        if not self.milliseconds:
            return f"| {name} | {kind} | not applicable | | | | |"
        matched = len(self.ious)
        recall, precision = (_share(matched, total) for total in (self.objects, self.segments))
        iou = "-"
        if matched:
            low, high = bootstrap_interval(np.array(self.ious), np.array(self.scenes), lambda v: float(v.mean()))
            iou = f"{np.mean(self.ious):.3f} [{low:.3f}, {high:.3f}]"
        boundary, ms = np.mean(self.boundaries), np.median(self.milliseconds)
        return f"| {name} | {kind} | {recall} | {precision} | {iou} | {boundary:.3f} | {ms:.0f} |"


def main() -> None:
    """Parse the command line, score, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path, help="folders of capture folders")
    parser.add_argument("--scenes", type=int, default=20, help="how many captures of each, from the first")
    parser.add_argument("--segmenter", action="append", help="only these; all when left out")
    parser.add_argument("--images", choices=("goal", "current"), action="append", help="only these; both when left out")
    parser.add_argument("--explained", action="store_true", help="also the masks that the default pipeline ends with")
    parser.add_argument("--each", action="store_true", help="a row for each capture; those without true masks left out")
    arguments = parser.parse_args()
    names = arguments.segmenter or SEGMENTERS.names()
    names = [*names, EXPLAINED] if arguments.explained else names
    kinds = arguments.images or ["current", "goal"]
    captures = {dataset: sorted(dataset.glob("*/goal"))[: arguments.scenes] for dataset in arguments.datasets}
    if arguments.each:
        captures = {goal.parent: [goal] for found in captures.values() for goal in found if _has_truth(goal.parent)}
    if empty := [dataset for dataset, found in captures.items() if not found]:
        parser.error(f"there is no capture in '{empty[0]}'")
    console = Console(soft_wrap=True)
    console.print(
        f"Recall and precision at IoU {MATCH_IOU}, mean IoU of the matches, 95 % intervals; median ms per image,"
    )
    console.print("what the scene's first image learns included.\n")
    console.print("| captures | segmenter | images | recall | precision | mean IoU | boundary F | ms |")
    console.print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for dataset, goals in captures.items():
        tallies = {(name, kind): Tally() for name in names for kind in kinds}
        with Progress(Console(stderr=True)).step(f"segmenting {dataset.name}", len(goals)) as advance:
            for number, goal in enumerate(goals):
                capture = load_capture(goal.parent)
                for name in names:
                    _score(name, capture, number, tallies)
                advance(1)
        for (name, kind), tally in tallies.items():
            console.print(f"| {dataset.name} {tally.row(name, kind)}", markup=False)


def match(segments: list[Segment], truth: list[Mask]) -> list[float]:
    """IoU of every pair above MATCH_IOU, under the one-to-one assignment that is best overall."""
    table = np.array(
        [[(mask & s.mask).sum() / (mask | s.mask).sum() for s in segments] for mask in truth], np.float64
    ).reshape(len(truth), len(segments))
    rows, columns = linear_sum_assignment(table, maximize=True)
    return [float(iou) for iou in table[rows, columns] if iou >= MATCH_IOU]


def boundary_f(segments: list[Segment], truth: list[Mask]) -> float:
    """F measure of the boundaries, every object's against those of the segment that overlaps it best."""
    if not segments or not truth:
        return float(not segments and not truth)
    table = np.array([[(mask & s.mask).sum() / (mask | s.mask).sum() for s in segments] for mask in truth])
    true, found = [_boundary(mask) for mask in truth], [_boundary(s.mask) for s in segments]
    reach = int(np.ceil(BOUNDARY * np.hypot(*truth[0].shape)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    hits, recalled = 0, 0
    for i, j in zip(*linear_sum_assignment(table, maximize=True), strict=True):
        near_true, near_found = (cv2.dilate(b.astype(np.uint8), disc) > 0 for b in (true[i], found[j]))
        hits += int((found[j] & near_true).sum())
        recalled += int((true[i] & near_found).sum())
    precision, recall = hits / sum(int(b.sum()) for b in found), recalled / sum(int(b.sum()) for b in true)
    return 2 * precision * recall / max(precision + recall, 1e-9)


def _boundary(mask: Mask) -> Mask:
    return mask & ~(cv2.erode(np.pad(mask, 1).astype(np.uint8), np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0)


def _has_truth(folder: Path) -> bool:
    capture = load_capture(folder)
    return all(frame.true_masks is not None for frame in (capture.goal, *capture.current))


def _explained(capture: Capture) -> list[Segment]:
    """Masks of the goal objects, as the default pipeline ends with them."""
    pipeline = make_runner(expand(load_experiment("estimate", {}))[0], None).pipeline
    return [estimate.segment for estimate in pipeline.run(capture)]


def _score(name: str, capture: Capture, number: int, tallies: dict[tuple[str, str], Tally]) -> None:
    segmenter = None if name == EXPLAINED else SEGMENTERS.create(name)
    images: list[tuple[str, Frame]] = [("goal", capture.goal), *(("current", frame) for frame in capture.current)]
    for kind, frame in images:
        if frame.true_masks is None:
            raise SystemExit(f"capture '{capture.name}' has no true masks to score against")
        if (name, kind) not in tallies:
            continue
        tally = tallies[name, kind]
        start = time.perf_counter()
        try:
            if segmenter is not None:
                segments = segmenter.segment(frame, capture.current)
            elif kind == "goal":
                segments = _explained(capture)
            else:
                continue
        except ToolkitError:
            # depth_plane on a goal image: it says so, and the table does too.
            tally.refused += 1
            continue
        tally.milliseconds.append((time.perf_counter() - start) * 1e3)
        truth = [mask for mask in frame.true_masks.values() if mask.sum() >= SMALLEST_PX]
        found = match(segments, truth)
        tally.objects += len(truth)
        tally.segments += len(segments)
        tally.ious += found
        tally.scenes += [number] * len(found)
        tally.boundaries.append(boundary_f(segments, truth))


def _share(part: int, total: int) -> str:
    low, high = wilson_interval(part, total)
    return f"{part / total if total else 0:.3f} [{low:.3f}, {high:.3f}]"


if __name__ == "__main__":
    main()
