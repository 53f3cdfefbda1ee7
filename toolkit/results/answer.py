"""The motions of one capture in words, for a terminal of 80 columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from toolkit.geometry import rotation_angle
from toolkit.types import Finding, Float, PoseEstimate

SURE = 0.5
"""Confidence above which an answer is called sure."""


def in_words(estimate: PoseEstimate) -> str:
    """What is known of one goal object: `sure`, `doubtful`, `found` (not judged), `withheld`, `unknown` or `failed`."""
    if estimate.T_goal_current is None:
        if estimate.instance is None:
            return "unknown"
        return "withheld" if estimate.status == "abstained" else "failed"
    if estimate.confidence is None:
        return "found"
    return "sure" if estimate.confidence > SURE else "doubtful"


COLUMNS = ("object", "instance", "answer", "confidence", "moves", "turns")


def rows(estimates: Sequence[PoseEstimate], points: Sequence[Float | None]) -> Iterator[tuple[str, ...]]:
    """The `COLUMNS` of every goal object, in words.

    Args:
        estimates: of one capture.
        points: for each, the (N, 3) world points of its instance, or None; they say how far it moves, on average.
    """
    for estimate, own in zip(estimates, points, strict=True):
        yield (
            str(estimate.goal_object),
            "" if estimate.instance is None else f"#{estimate.instance}",
            in_words(estimate),
            "" if estimate.confidence is None else f"{estimate.confidence:.0%}",
            *_motion(estimate, own),
        )


def motions(estimates: Sequence[PoseEstimate], points: Sequence[Float | None]) -> Table:
    """The `rows` as a table."""
    table = Table(*COLUMNS, box=SIMPLE_HEAD)
    for row in rows(estimates, points):
        table.add_row(*row)
    return table


def _motion(estimate: PoseEstimate, points: Float | None) -> tuple[str, str]:
    T = estimate.T_goal_current
    if T is None or points is None:
        return "", ""
    moved = float(np.linalg.norm(estimate.move(points) - points, axis=1).mean())
    return f"{moved * 100:.1f} cm", f"{np.degrees(rotation_angle(T[:3, :3])):.1f} deg"


def to_look_at(estimates: Sequence[PoseEstimate], missing: Sequence[int], findings: Sequence[Finding]) -> Iterator[str]:
    """Sentences about what a person should look at before any robot moves; none where all is sure.

    Args:
        estimates: of one capture.
        missing: instances of the current scene that the goal does not show.
        findings: what was found wrong with the capture.
    """
    for finding in findings:
        yield f"the capture ({finding.severity}): {finding.sentence}"
    doubts: dict[str, list[int]] = {}
    for estimate in estimates:
        if doubt := _doubt(estimate):
            doubts.setdefault(doubt, []).append(estimate.goal_object)
    for doubt, objects in doubts.items():
        yield f"object{'s' * (len(objects) > 1)} {', '.join(map(str, objects))}: {doubt}"
    if missing:
        named = ", ".join(f"#{instance}" for instance in missing)
        yield f"not seen in the goal: {named}"


def _doubt(estimate: PoseEstimate) -> str:
    """What a person should know of an object before it is moved; empty where there is nothing."""
    words = in_words(estimate)
    if words == "doubtful":
        others = 0 if estimate.equivalents is None else len(estimate.equivalents) - 1
        alike = f"; {others} other motion{'s' if others > 1 else ''} would look the same" if others else ""
        return f"the motion is doubtful{alike}"
    return "" if estimate.failure is None else f"{words}: {estimate.failure.reason}"


def why_nothing(estimates: Sequence[PoseEstimate], regions: int) -> str:
    """One sentence on why no motion was found, with the likely cause.

    Args:
        estimates: of one capture, none with a motion.
        regions: number of object regions seen in the current frames.
    """
    if not regions:
        cause = "no object stands out from the table in the depth of the current frames"
        return f"no motion: {cause}; are they higher than a centimetre, and on the table?"
    if not estimates:
        return "no motion: no object was found in the goal image; does it show the same table, in similar light?"
    reasons = {e.failure.reason for e in estimates if e.failure is not None}
    return f"no motion is believed: {min(sorted(reasons), key=len)}; look at overlay.png"
