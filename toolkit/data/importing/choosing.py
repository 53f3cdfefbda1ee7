"""Which images of a recording become the current frames, and which one the goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from toolkit.data.importing.recording import Recording, Shot
from toolkit.errors import ToolkitError, suggest

VIEWS = 8
"""Frames that are taken where none are asked for: the paper's number of views."""


@dataclass(frozen=True)
class Frames:
    """Which images are the current frames; 8 spread over the path where neither is given.

    Attributes:
        named: `3,10,left.png` or `100:300`, or both: numbers or names, and ranges of numbers without their ends.
        every: every so-manieth of these.
    """

    named: str | None = None
    every: int | None = None

    def choose(self, recording: Recording, goal: Shot | None) -> list[Shot]:
        """The chosen shots that have depth, in their order, the goal not among them.

        Raises:
            ToolkitError: a name is unknown, or no image is left.
        """
        chosen = list(recording.shots) if self.named is None else _named(recording, self.named)
        chosen = [shot for shot in chosen if shot.has_depth and shot is not goal]
        if not chosen:
            raise ToolkitError("no image with depth is left for the current frames; choose others with --frames")
        if self.every is not None:
            return chosen[:: self.every]
        return spread(chosen, VIEWS) if self.named is None else chosen


def find(recording: Recording, key: str) -> Shot:
    """The image of that name, with or without folder and suffix, or of that number.

    Raises:
        ToolkitError: there is none, or there are several.
    """
    for alike in (_is_named, _is_filed, _is_numbered):
        found = [shot for shot in recording.shots if alike(shot, key)]
        if len(found) == 1:
            return found[0]
        if found:
            raise ToolkitError(f"'{key}' may be {found[0].name} or {found[1].name}; name it with its folder")
    names = [shot.name for shot in recording.shots]
    last = recording.shots[-1].index
    raise ToolkitError(
        f"no image '{key}' in the recording; its images are '{names[0]}' to '{names[-1]}', numbers up to {last}"
        + (suggest(key, names) if len(names) < 1000 else "")
    )


def spread(shots: Sequence[Shot], count: int) -> list[Shot]:
    """At most `count` shots, as far from each other as can be: the first, then always the farthest; no place twice."""
    eyes = np.array([shot.T_world_camera[:3, 3] for shot in shots])
    taken, apart = [0], np.linalg.norm(eyes - eyes[0], axis=1)
    while len(taken) < min(count, len(shots)) and apart.max() > 0:
        taken.append(int(apart.argmax()))
        apart = np.minimum(apart, np.linalg.norm(eyes - eyes[taken[-1]], axis=1))
    return [shots[i] for i in sorted(taken)]


def _named(recording: Recording, text: str) -> list[Shot]:
    chosen: dict[int, Shot] = {}
    for part in text.split(","):
        first, colon, end = part.strip().partition(":")
        if colon and all(side == "" or side.isdigit() for side in (first, end)):
            low, high = int(first or 0), int(end) if end else recording.shots[-1].index + 1
            chosen |= {shot.index: shot for shot in recording.shots if low <= shot.index < high}
        else:
            shot = find(recording, part.strip())
            chosen[shot.index] = shot
    return [chosen[index] for index in sorted(chosen)]


def _is_named(shot: Shot, key: str) -> bool:
    return shot.name == key


def _is_filed(shot: Shot, key: str) -> bool:
    return key in (Path(shot.name).name, Path(shot.name).stem)


def _is_numbered(shot: Shot, key: str) -> bool:
    return key.isdigit() and shot.index == int(key)
