"""What a check of a capture has to say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from toolkit.types.arrays import require, require_share

Severity = Literal["refused", "doubtful", "left out", "said"]
"""What follows: nothing can be right; answers are not to be believed far; some frames are not used; nothing."""

Shown = Literal["cameras", "table"]
"""Where each current frame sees the table, by its pose; or the table from above, in current frames and in the goal."""


@dataclass(frozen=True)
class Finding:
    """Something about a capture that a person should know.

    Attributes:
        severity: what follows from it.
        sentence: what was measured, its likely cause, and the remedy.
        cap: 0..1, no answer from this capture is surer than this.
        frames: indices of the current frames it is about; empty where that is all, or the goal.
        shown: which picture shows it; None where the images themselves do.

    Raises:
        ToolkitError: the cap is out of range, or nothing is left out where something is said to be.
    """

    severity: Severity
    sentence: str
    cap: float = 1.0
    frames: tuple[int, ...] = ()
    shown: Shown | None = None

    def __post_init__(self) -> None:
        require_share(self.cap, "a finding's cap")
        require(self.severity != "left out" or self.frames, "a finding that leaves frames out must name them")
