"""Frozen values that pass between stages. Shapes, dtypes and units are checked where the values are made.

Conventions (docs/conventions.md): NumPy arrays, SI units, pixel (0, 0) is the centre of the top-left pixel, OpenCV
camera axes (x right, y down, z forward), `T_a_b` is the 4x4 that takes points of frame b into frame a.
"""

from toolkit.types.arm import ArmWorld, Cubes, Shape, Solid
from toolkit.types.arrays import Float, Image, Mask
from toolkit.types.captures import Capture, ObjectModel, Placed, TrueObject
from toolkit.types.estimates import Abstention, Ambiguity, Failure, PnPSolution, PoseEstimate, Refined, Status
from toolkit.types.findings import Finding, Severity
from toolkit.types.gripper import Gripper
from toolkit.types.images import Camera, Crop, Frame, Segment
from toolkit.types.matching import Correspondences, Matches, Region

__all__ = [
    "Abstention",
    "Ambiguity",
    "ArmWorld",
    "Camera",
    "Capture",
    "Correspondences",
    "Crop",
    "Cubes",
    "Failure",
    "Finding",
    "Float",
    "Frame",
    "Gripper",
    "Image",
    "Mask",
    "Matches",
    "ObjectModel",
    "Placed",
    "PnPSolution",
    "PoseEstimate",
    "Refined",
    "Region",
    "Segment",
    "Severity",
    "Shape",
    "Solid",
    "Status",
    "TrueObject",
]
