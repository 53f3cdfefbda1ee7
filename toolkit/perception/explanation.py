"""What a goal image shows, said in terms of the current scene's objects: which stands where, and what is left over."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from toolkit.errors import ToolkitError
from toolkit.geometry import is_rigid
from toolkit.perception.fusion import Models
from toolkit.types import Float, Frame, Segment


@dataclass(frozen=True, eq=False)
class ExplainTask:
    """One goal image to explain.

    Attributes:
        goal: the goal image.
        segments: what the goal segmenter found in it; none of it need be one whole object.
        models: the fused models of the current scene's instances.
    """

    goal: Frame
    segments: tuple[Segment, ...]
    models: Models


@dataclass(frozen=True, eq=False)
class Placement:
    """One instance of the current scene, found in the goal image.

    Attributes:
        instance: the database instance.
        T_goal_current: (4, 4) motion in world coordinates, metres, that takes it there.
        segment: what the goal image shows of it.
        trust: 0..1, probability that this is the instance and that the segment is its own.
        judged: what the trust is made from, by the explainer's own names.
    """

    instance: int
    T_goal_current: Float
    segment: Segment
    trust: float
    judged: Mapping[str, float] = field(default_factory=dict[str, float])

    def __post_init__(self) -> None:
        if not is_rigid(self.T_goal_current):
            raise ToolkitError("a placement's motion must be a rigid transform")
        if not 0 <= self.trust <= 1:
            raise ToolkitError(f"a placement's trust must be in 0..1, got {self.trust}")


@dataclass(frozen=True, eq=False)
class Explanation:
    """A goal image explained.

    Attributes:
        placements: instances found in it, each at most once, their segments disjoint.
        unknown: what stands on the table in it and is none of the current scene's instances.
        joined: groups of instances that touch and were moved as one, so that they are one object; its placement is that
            of the first.
    """

    placements: tuple[Placement, ...]
    unknown: tuple[Segment, ...]
    joined: tuple[tuple[int, ...], ...] = ()
