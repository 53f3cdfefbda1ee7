"""What takes hold of objects."""

from __future__ import annotations

from dataclasses import dataclass

from toolkit.types.arrays import require


@dataclass(frozen=True)
class Gripper:
    """A parallel gripper: two fingers and what carries them.

    Its origin lies between the fingertips; x points from one finger to the other, z the way it approaches.

    Attributes:
        stroke_m: widest opening, metres.
        finger_m: box of one finger, metres: thickness (x), width (y), length from fingertip to palm (z).
        palm_m: box behind the fingers, metres: x, y, z.

    Raises:
        ToolkitError: a measure is not positive.
    """

    stroke_m: float
    finger_m: tuple[float, float, float]
    palm_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        measures = (self.stroke_m, *self.finger_m, *self.palm_m)
        require(min(measures) > 0, f"a gripper's measures must be positive, got {measures}")
