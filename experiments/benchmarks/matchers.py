"""Score and time every matcher on goal and current crops of one object, against depth and pose; prints Markdown.

toolkit dataset build captures --scenes 4 --seed 0
python experiments/benchmarks/matchers.py captures
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.errors import ToolkitError
from toolkit.geometry import invert, project, transform_points
from toolkit.perception.crops import crop_region
from toolkit.perception.lifting import lift_pixels
from toolkit.progress import Advance, Progress
from toolkit.stages import MATCHERS, Matcher
from toolkit.types import Crop, Float, Frame, Mask, Matches, Segment

RIGHT_PX = 3.0
"""A match is right where its true place in the goal image is this near."""

SAME_SURFACE_M = 0.01
"""The goal image shows a point of the object where none is nearer to its camera by more than this."""

SMALLEST_PX = 60


@dataclass(frozen=True, eq=False)
class Pair:
    """One object in the goal image and in one current frame.

    Attributes:
        instance: the object.
        goal, goal_segment: the goal image and the object's true mask there.
        frame, segment: the current frame and the object's true mask there.
        T_goal_current: (4, 4) its true motion, metres.
        surface: (H, W) metres from the goal camera to the object's nearest point, as the current frames saw it.
    """

    instance: int
    goal: Frame
    goal_segment: Segment
    frame: Frame
    segment: Segment
    T_goal_current: Float
    surface: Float

    def truth(self, xy: Float) -> tuple[Float, Mask, Mask]:
        """Where pixels of the current frame are in the goal image.

        Args:
            xy: (M, 2) pixels of the current frame.

        Returns:
            (M, 2) goal pixels; (M,) bool known: the depth around the pixel is whole; (M,) bool seen: known, and on
            the object's visible surface in the goal image.
        """
        points, known = lift_pixels(self.frame, self.segment.mask, xy)
        pixels, depth = to_goal(self.goal, self.T_goal_current, points)
        rows, columns, inside = pixel_under(self.goal, pixels)
        ahead = depth < self.surface[rows, columns] + SAME_SURFACE_M
        seen = known & inside & self.goal_segment.mask[rows, columns] & ahead
        return pixels, known, seen

    def overlap(self) -> float:
        """Part of the object's pixels in the current frame that the goal image shows too."""
        y, x = np.nonzero(self.segment.mask)
        _, known, seen = self.truth(np.stack([x, y], axis=1).astype(np.float64))
        return float(seen.sum() / max(known.sum(), 1))


@dataclass
class Tally:
    """What one matcher did; one entry per crop in `extract_ms`, one per pair in the others.

    Milliseconds are the process's own, of all its threads, so that a busy machine does not change them.
    """

    extract_ms: list[float] = field(default_factory=list[float])
    match_ms: list[float] = field(default_factory=list[float])
    matches: list[int] = field(default_factory=list[int])
    judged: list[int] = field(default_factory=list[int])
    right: list[int] = field(default_factory=list[int])

    def row(self, name: str) -> str:
        """One Markdown row."""
        share = f"{sum(self.right) / sum(self.judged):.3f}" if sum(self.judged) else "-"
        extract, match = np.median(self.extract_ms), np.median(self.match_ms)
        found, right = np.median(self.matches), np.median(self.right)
        return f"| {name} | {len(self.matches)} | {extract:.0f} | {match:.1f} | {found:.0f} | {right:.0f} | {share} |"


def main() -> None:
    """Parse the command line, score, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, help="folder of capture folders, with truth")
    parser.add_argument("--scenes", type=int, default=4, help="how many captures, from the first")
    parser.add_argument("--overlap", type=float, default=0.3, help="least part of the object that both images show")
    parser.add_argument("--matcher", action="append", help="only these; all when left out")
    parser.add_argument("--turns", action="store_true", help="also with quarter turns of the goal crop")
    options = parser.parse_args()
    try:
        folders = read_dataset(options.dataset)[: options.scenes]
        pairs = [pair for folder in folders for pair in pairs_of(folder) if pair.overlap() >= options.overlap]
        ready, reasons = ready_matchers(options.matcher or MATCHERS.names(), turns=options.turns)
    except ToolkitError as error:
        parser.error(str(error))
    if not pairs:
        parser.error(f"no object of '{options.dataset}' is seen well enough in a goal image and a current frame")
    print(
        f"{len(pairs)} pairs of {len(folders)} scenes with at least {options.overlap:.0%} overlap; medians, "
        f"milliseconds of CPU; right: within {RIGHT_PX:g} px in the goal image and on the side it shows, "
        "of the matches where depth is whole.\n"
    )
    print(
        "| matcher | pairs | extract, ms per crop | match, ms per pair | matches per pair "
        "| right per pair | share right |\n"
        "| --- | --- | --- | --- | --- | --- | --- |",
        flush=True,
    )
    for name, matcher in ready.items():
        with Progress(Console(stderr=True)).step(name, len(pairs)) as advance:
            result = tally(matcher, pairs, advance)
        print(result.row(name), flush=True)
    print("".join(f"\nSkipped: {reason}." for reason in reasons))


def pairs_of(folder: Path) -> Iterator[Pair]:
    """Every object of a capture with every current frame that shows it.

    Raises:
        ToolkitError: the capture lacks the truth.
    """
    capture = load_capture(folder)
    goal = capture.goal
    if capture.truth is None or goal.true_masks is None:
        raise ToolkitError(f"capture '{folder}' has no truth to judge matches by")
    for instance, mask in goal.true_masks.items():
        segments = {
            frame.index: Segment(frame.true_masks[instance])
            for frame in capture.current
            if frame.true_masks and instance in frame.true_masks
        }
        T = capture.truth[instance].T_goal_current
        seen = [(frame, segments[frame.index]) for frame in capture.current if frame.index in segments]
        surface = goal_surface(goal, T, seen)
        for frame, segment in seen:
            if min(segment.mask.sum(), mask.sum()) >= SMALLEST_PX:
                yield Pair(instance, goal, Segment(mask), frame, segment, T, surface)


def goal_surface(goal: Frame, T_goal_current: Float, seen: list[tuple[Frame, Segment]]) -> Float:
    """(H, W) depth of an object in the goal image, from all that current frames measured of it; inf elsewhere."""
    surface = np.full(goal.rgb.shape[:2], np.inf)
    for frame, segment in seen:
        y, x = np.nonzero(segment.mask)
        points, known = lift_pixels(frame, segment.mask, np.stack([x, y], axis=1).astype(np.float64))
        pixels, depth = to_goal(goal, T_goal_current, points[known])
        rows, columns, inside = pixel_under(goal, pixels)
        np.minimum.at(surface, (rows[inside], columns[inside]), depth[inside])
    # Closes the gaps between the pixels of frames that saw the object from further away.
    return np.asarray(cv2.erode(surface, np.ones((3, 3))), np.float64)


def to_goal(goal: Frame, T_goal_current: Float, points: Float) -> tuple[Float, Float]:
    """(N, 2) goal pixels and (N,) depths of (N, 3) points of the current world."""
    moved = transform_points(T_goal_current, points)
    return project(goal.camera.K, invert(goal.camera.T_world_camera), moved)


def pixel_under(goal: Frame, pixels: Float) -> tuple[NDArray[np.int64], NDArray[np.int64], Mask]:
    """Rows, columns and (N,) bool inside the image, of the pixels under (N, 2) positions; 0, 0 where not inside."""
    x, y = np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(np.int64).T
    inside = (x >= 0) & (y >= 0) & (x < goal.camera.width) & (y < goal.camera.height)
    return np.where(inside, y, 0), np.where(inside, x, 0), inside


def ready_matchers(names: list[str], *, turns: bool) -> tuple[dict[str, Any], list[str]]:
    """The matchers that can run here, with `turns` each that has them a second time; and why the others cannot."""
    ready: dict[str, Any] = {}
    reasons: list[str] = []
    for name in names:
        plugin = MATCHERS.get(name)
        variants = {name: {}}
        if turns and "rotations" in plugin.Config.model_fields:
            variants[f"{name}, 4 turns"] = {"rotations": 4}
        made = {label: MATCHERS.create(name, settings) for label, settings in variants.items()}
        try:
            plugin().check_ready()
        except ToolkitError as error:
            reasons.append(f"{name}: {error}")
            continue
        ready |= made
    return ready, reasons


def tally(matcher: Matcher, pairs: list[Pair], advance: Advance) -> Tally:
    """Run one matcher over all pairs; every crop is extracted once."""
    result = Tally()
    kept: dict[tuple[int, int], tuple[Crop, Any]] = {}
    met: set[tuple[int, int]] = set()

    def extract(frame: Frame, segment: Segment, instance: int) -> tuple[Crop, Any]:
        key = id(frame), instance
        if key not in kept:
            crop = crop_region(frame.rgb, segment, matcher.crop_size)
            start = time.process_time()
            (features,) = matcher.extract([crop])
            result.extract_ms.append(1e3 * (time.process_time() - start))
            kept[key] = crop, features
        return kept[key]

    for pair in pairs:
        query, goal = extract(pair.goal, pair.goal_segment, pair.instance)
        reference, current = extract(pair.frame, pair.segment, pair.instance)
        if (id(pair.goal), pair.instance) not in met:
            # What a query is turned for at its first match is no part of a pair's time.
            met.add((id(pair.goal), pair.instance))
            matcher.match(goal, [current])
        start = time.process_time()
        (found,) = matcher.match(goal, [current])
        result.match_ms.append(1e3 * (time.process_time() - start))
        judged, right = judge(pair, query, reference, found)
        result.matches.append(len(found))
        result.judged.append(judged)
        result.right.append(right)
        advance(1)
    return result


def judge(pair: Pair, query: Crop, reference: Crop, found: Matches) -> tuple[int, int]:
    """How many matches have depth to be judged by, and how many of these are right."""
    pixels, known, seen = pair.truth(reference.to_image(found.reference_xy))
    errors = np.linalg.norm(pixels - query.to_image(found.query_xy), axis=1)
    return int(known.sum()), int((seen & (errors <= RIGHT_PX)).sum())


if __name__ == "__main__":
    main()
