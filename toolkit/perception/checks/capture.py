"""A whole capture checked before it is believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from toolkit.errors import ToolkitError
from toolkit.perception.checks.goal import check_goal
from toolkit.perception.checks.pictures import check_exposure, check_steps
from toolkit.perception.checks.poses import check_poses
from toolkit.perception.checks.sighting import sight
from toolkit.perception.tabletop.table import find_table
from toolkit.types import Capture, Finding, PoseEstimate

_UNSEEN = 0.5


def check_capture(capture: Capture) -> list[Finding]:
    """Say what is wrong with a capture, worst first; nothing where all is as it should be.

    What makes all that follows meaningless ends the check: depth in steps, then frames that contradict each other.
    """
    if refused := check_steps(capture.current):
        return refused
    findings = check_exposure(capture.current, capture.goal)
    seen = {frame.index: sight(frame) for frame in capture.current}
    sightings = [sighting for sighting in seen.values() if sighting is not None]
    if not sightings:
        sentence = "no current frame's depth shows a table; look at the table from above, with depth"
        return _sorted([*findings, Finding("doubtful", sentence, _UNSEEN)])
    findings += [
        Finding("left out", f"current frame {index} shows no table and is not used", frames=(index,))
        for index, sighting in seen.items()
        if sighting is None
    ]
    findings += check_poses(sightings)
    if not any(finding.severity == "refused" for finding in findings):
        out = {index for finding in findings if finding.severity == "left out" for index in finding.frames}
        try:
            table = find_table([s.frame for s in sightings if s.frame.index not in out])
        except ToolkitError as error:
            return _sorted([*findings, Finding("doubtful", f"the frames share no table: {error}", _UNSEEN)])
        findings += check_goal(capture.goal, table)
    return _sorted(findings)


def refuse(capture: Capture, findings: Sequence[Finding]) -> None:
    """Raise ToolkitError where what was found cannot be right."""
    for finding in findings:
        if finding.severity == "refused":
            raise ToolkitError(f"capture '{capture.name}': {finding.sentence}")


def usable(capture: Capture, findings: Sequence[Finding]) -> Capture:
    """The capture without the frames that are left out; as it is where none would be left."""
    out = {index for finding in findings if finding.severity == "left out" for index in finding.frames}
    kept = tuple(frame for frame in capture.current if frame.index not in out)
    return replace(capture, current=kept) if kept else capture


def doubted(estimates: Sequence[PoseEstimate], findings: Sequence[Finding]) -> list[PoseEstimate]:
    """The estimates, none of them surer than the findings allow."""
    cap = min((finding.cap for finding in findings), default=1.0)
    return [e if e.confidence is None else replace(e, confidence=min(e.confidence, cap)) for e in estimates]


_ORDER = ("refused", "doubtful", "left out", "said")


def _sorted(findings: Sequence[Finding]) -> list[Finding]:
    return sorted(findings, key=lambda finding: _ORDER.index(finding.severity))
