"""A capture checked before it is believed: its current frames, then each goal against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from toolkit.errors import ToolkitError
from toolkit.perception.checks.goal import check_table
from toolkit.perception.checks.pictures import check_exposure, check_goal_exposure, check_steps
from toolkit.perception.checks.poses import check_poses
from toolkit.perception.checks.sighting import sight
from toolkit.perception.checks.tint import check_tint
from toolkit.perception.tabletop.table import find_table
from toolkit.types import Capture, Finding, Float, Frame, PoseEstimate

_UNSEEN = 0.5


class RefusedError(ToolkitError):
    """A capture that cannot be right."""


def check_capture(capture: Capture) -> list[Finding]:
    """Say what is wrong with a capture, worst first; nothing where all is as it should be."""
    findings = check_current(capture.current)
    if any(finding.severity == "refused" for finding in findings):
        return findings
    return together(findings, check_goal(capture.goal, usable(capture.current, findings)))


def together(of_frames: Sequence[Finding], of_goal: Sequence[Finding]) -> list[Finding]:
    """The findings of current frames and of their goal, worst first.

    A goal that does not fit frames which contradict each other may be right itself: the frames are refused first.
    """
    misfit = any(finding.severity == "refused" and finding.shown == "table" for finding in of_goal)
    judged = [
        replace(finding, severity="refused")
        if misfit and finding.severity == "doubtful" and finding.shown == "cameras"
        else finding
        for finding in of_frames
    ]
    return by_severity([*judged, *of_goal])


def check_current(frames: Sequence[Frame]) -> list[Finding]:
    """Say what is wrong with current frames, worst first."""
    if refused := check_steps(frames):
        return refused
    seen = {frame.index: sight(frame) for frame in frames}
    sightings = [sighting for sighting in seen.values() if sighting is not None]
    if not sightings:
        sentence = "no current frame's depth shows a table; look at the table from above, with depth"
        return by_severity([*check_exposure(frames), Finding("doubtful", sentence, _UNSEEN)])
    blind = [
        Finding("left out", f"current frame {index} shows no table and is not used", frames=(index,))
        for index, sighting in seen.items()
        if sighting is None
    ]
    return by_severity([*check_exposure(frames), *blind, *check_poses(sightings)])


def check_goal(goal: Frame, frames: Sequence[Frame], T_world_frames: Float | None = None) -> list[Finding]:
    """Say what is wrong with a goal image, worst first, given current frames that can be right.

    Args:
        goal: in the same frame of reference as `frames`.
        frames: the current ones.
        T_world_frames: (4, 4) from there into the world in which the poses were written down; None where that is it.
    """
    try:
        table = find_table(frames)
    except ToolkitError:
        # The current frames' own findings say so.
        return check_goal_exposure(goal)
    # Colours are compared only where the goal shows the same table.
    return by_severity(
        [*check_goal_exposure(goal), *(check_table(goal, table, T_world_frames) or check_tint(goal, table))]
    )


def refuse(findings: Sequence[Finding]) -> None:
    """Raise RefusedError where what was found cannot be right."""
    for finding in findings:
        if finding.severity == "refused":
            raise RefusedError(finding.sentence)


def usable(frames: Sequence[Frame], findings: Sequence[Finding]) -> tuple[Frame, ...]:
    """The frames without those that are left out; all of them where none would be left."""
    out = {index for finding in findings if finding.severity == "left out" for index in finding.frames}
    return tuple(frame for frame in frames if frame.index not in out) or tuple(frames)


def doubted(estimates: Sequence[PoseEstimate], findings: Sequence[Finding]) -> list[PoseEstimate]:
    """The estimates, none of them surer than the findings allow."""
    cap = min((finding.cap for finding in findings), default=1.0)
    return [e if e.confidence is None else replace(e, confidence=min(e.confidence, cap)) for e in estimates]


_ORDER = ("refused", "doubtful", "left out", "said")


def by_severity(findings: Sequence[Finding]) -> list[Finding]:
    """The findings, worst first."""
    return sorted(findings, key=lambda finding: _ORDER.index(finding.severity))
