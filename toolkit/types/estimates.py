"""What stages say of an object's pose: failures, motions, and how sure they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, is_rigid, transform_points
from toolkit.types.arrays import (
    Float,
    Mask,
    checked,
    checked_covariance,
    checked_motion,
    freeze,
    require,
    require_share,
)
from toolkit.types.images import Segment
from toolkit.types.matching import Correspondences

Ambiguity = Literal["none", "symmetric", "hidden"]
"""Why several motions agree with a goal image: none do; the object looks the same from everywhere after each; or it
does not, but the goal image does not show the side that would tell (a mug's handle behind the mug)."""


Status = Literal["estimated", "abstained", "failed"]
"""Whether an object has a motion; `abstained` where one was found and is not believed."""


@dataclass(frozen=True)
class Failure:
    """A stage that could not answer. Counted in every denominator; never an identity pose, never a NaN."""

    stage: str
    reason: str


@dataclass(frozen=True)
class Abstention(Failure):
    """An answer that its own verification does not believe: withheld, which is not the same as not found."""


@dataclass(frozen=True, eq=False)
class Refined:
    """A motion that was compared with the goal image.

    Attributes:
        T_goal_current: (4, 4) float64 motion in world coordinates, metres.
        confidence: 0..1, probability of being right within 5 deg and 2 cm.
        equivalents: (E, 4, 4) float64 motions that the goal image does not tell apart from it, itself the first.
        ambiguity: what the equivalents are (`Ambiguity`).
        covariance: (6, 6) float64 of (turn, shift) about the object's centre, rad^2 and m^2; rows and columns of what
            was held fixed are 0.

    Raises:
        ToolkitError: a value is not as said.
    """

    T_goal_current: Float
    confidence: float
    equivalents: Float
    ambiguity: Ambiguity
    covariance: Float

    def __post_init__(self) -> None:
        motion = checked_motion(self.T_goal_current, "a refined motion")
        require_share(self.confidence, "a refined motion's confidence")
        equivalents = _checked_equivalents(self.equivalents, motion, self.ambiguity)
        covariance = checked_covariance(self.covariance, "a refined motion's covariance")
        freeze(self, T_goal_current=motion, equivalents=equivalents, covariance=covariance)


@dataclass(frozen=True, eq=False)
class PnPSolution:
    """A solved PnP problem.

    Attributes:
        T_camera_world: (4, 4) float64 that takes the correspondences' points into the goal camera.
        inliers: (N,) bool.
        covariance: (6, 6) float64 of (turn, shift) in the goal's world about the points' mean, rad^2 and m^2; rows and
            columns of what was held fixed are 0. None where the solver gives none.

    Raises:
        ToolkitError: a value is not as said.
    """

    T_camera_world: Float
    inliers: Mask
    covariance: Float | None = None

    def __post_init__(self) -> None:
        T = checked_motion(self.T_camera_world, "a PnP solution")
        freeze(self, T_camera_world=T, inliers=checked(self.inliers, (None,), np.bool_, "a PnP solution's inliers"))
        if self.covariance is not None:
            freeze(self, covariance=checked_covariance(self.covariance, "a PnP solution's covariance"))


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """The answer for one goal object.

    Attributes:
        goal_object: index among the goal image's segments.
        segment: its mask in the goal image.
        instance: the database instance chosen, or None.
        T_goal_current: (4, 4) float64 motion in world coordinates (metres), or None.
        failure: why there is no motion, or None.
        confidence: 0..1, or None where the pipeline gives none.
        equivalents: (E, 4, 4) float64 motions that look the same, this one the first; None where that was not asked.
        ambiguity: what the equivalents are, or None.
        covariance: (6, 6) float64 of (turn, shift) in the goal's world, or None (`Refined`, `PnPSolution`).
        correspondences: what the pose was solved from, or None.
        inliers: (N,) bool over the correspondences, or None.
        candidates: (database row, number of correspondences) of every accepted candidate, in the order in which the
            correspondences are joined.
        matcher_calls: goal-candidate pairs that were matched locally.
        time_ms: milliseconds by stage.
        cached: True when any stage output came from the cache, so that `time_ms` is not the stage's own time.

    Raises:
        ToolkitError: there is neither a motion nor a failure, or both; or a value is not as said.
    """

    goal_object: int
    segment: Segment
    instance: int | None
    T_goal_current: Float | None
    failure: Failure | None = None
    confidence: float | None = None
    equivalents: Float | None = None
    ambiguity: Ambiguity | None = None
    covariance: Float | None = None
    correspondences: Correspondences | None = None
    inliers: Mask | None = None
    candidates: tuple[tuple[int, int], ...] = ()
    matcher_calls: int = 0
    time_ms: Mapping[str, float] = field(default_factory=dict[str, float])
    cached: bool = False

    def __post_init__(self) -> None:
        require((self.T_goal_current is None) != (self.failure is None), "an estimate has a motion or a failure")
        require(self.goal_object >= 0 and (self.instance is None or self.instance >= 0), "objects count from 0")
        if self.T_goal_current is not None:
            freeze(self, T_goal_current=checked_motion(self.T_goal_current, "T_goal_current"))
        if self.confidence is not None:
            require_share(self.confidence, "an estimate's confidence")
        if self.covariance is not None:
            freeze(self, covariance=checked_covariance(self.covariance, "an estimate's covariance"))
        if self.equivalents is not None and self.T_goal_current is not None:
            equivalents = _checked_equivalents(self.equivalents, self.T_goal_current, self.ambiguity)
            freeze(self, equivalents=equivalents)
        if self.inliers is not None:
            require(self.correspondences is not None, "an estimate's inliers are some of its correspondences")
            among = len(self.correspondences or ())
            freeze(self, inliers=checked(self.inliers, (among,), np.bool_, "an estimate's inliers"))

    @property
    def status(self) -> Status:
        """Whether there is a motion."""
        if self.failure is None:
            return "estimated"
        return "abstained" if isinstance(self.failure, Abstention) else "failed"

    def move(self, points: Float) -> Float:
        """Apply the motion to (N, 3) world points. Raises ToolkitError when there is none."""
        if self.T_goal_current is None:
            raise ToolkitError("a failed estimate moves nothing")
        return transform_points(self.T_goal_current, points)

    def in_world(self, T: Float) -> PoseEstimate:
        """The estimate in another world, into which (4, 4) `T` takes points of its own."""
        back, turns = invert(T), np.kron(np.eye(2), T[:3, :3])
        motion, others, covariance = self.T_goal_current, self.equivalents, self.covariance
        if covariance is not None:
            covariance = turns @ covariance @ turns.T
            # A variance of 0 may come out a little below it.
            np.fill_diagonal(covariance, np.maximum(np.diagonal(covariance), 0))
        return replace(
            self,
            T_goal_current=None if motion is None else T @ motion @ back,
            equivalents=None if others is None else T @ others @ back,
            covariance=covariance,
            correspondences=None if self.correspondences is None else self.correspondences.moved(T),
        )


def _checked_equivalents(equivalents: Float, motion: Float, ambiguity: Ambiguity | None) -> Float:
    """(E, 4, 4) float64 motions, `motion` the first; none besides it just where the ambiguity is none."""
    motions = checked(equivalents, (None, 4, 4), np.float64, "the equivalents")
    require(
        len(motions) > 0 and np.allclose(motions[0], motion), "the first of the equivalents must be the motion itself"
    )
    require(all(map(is_rigid, motions)), "every equivalent must be a rigid transform")
    known = get_args(Ambiguity)
    require(ambiguity in known, f"the equivalents' ambiguity must be one of {', '.join(known)}, got {ambiguity}")
    alone = len(motions) == 1
    require(alone == (ambiguity == "none"), f"{len(motions)} equivalents cannot have the ambiguity '{ambiguity}'")
    return motions
