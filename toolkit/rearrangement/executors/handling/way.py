"""What an arm does to move one object, as paths of its joints."""

from __future__ import annotations

from dataclasses import dataclass

from toolkit.rearrangement.moves import Grasp
from toolkit.types import Float


@dataclass(frozen=True, eq=False)
class Way:
    """Everything an arm does to move one object.

    Attributes:
        grasp: how it takes hold.
        to_grasp: (N, J) free path to above the grasp.
        approach: (N, J) along the gripper's axis.
        lift: (N, J) straight up.
        transfer: (N, J) free path with the object.
        lower: (N, J) straight down.
        retreat: (N, J) back along the gripper's axis.
    """

    grasp: Grasp
    to_grasp: Float
    approach: Float
    lift: Float
    transfer: Float
    lower: Float
    retreat: Float
