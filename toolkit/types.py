"""Frozen values that pass between stages. Shapes, dtypes and units are checked where the values are made.

Conventions (docs/conventions.md): NumPy arrays, SI units, pixel (0, 0) is the centre of the top-left pixel, OpenCV
camera axes (x right, y down, z forward), `T_a_b` is the 4x4 that takes points of frame b into frame a.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.geometry import is_rigid, transform_points

Float = NDArray[np.floating[Any]]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

Ambiguity = Literal["none", "symmetric", "hidden"]
"""Why several motions agree with a goal image: none do; the object looks the same from everywhere after each; or it
does not, but the goal image does not show the side that would tell (a mug's handle behind the mug)."""


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ToolkitError(message)


def _readonly(array: NDArray[Any]) -> NDArray[Any]:
    view = array.view()
    view.flags.writeable = False
    return view


def _freeze(instance: object, **values: NDArray[Any]) -> None:
    for name, value in values.items():
        object.__setattr__(instance, name, _readonly(value))


@dataclass(frozen=True, eq=False)
class Camera:
    """A posed pinhole camera.

    Attributes:
        K: (3, 3) float64 intrinsics, in pixels, no skew, last row (0, 0, 1).
        T_world_camera: (4, 4) float64 rigid pose of the camera (metres), OpenCV axes.
        width: image width, pixels.
        height: image height, pixels.

    Raises:
        ToolkitError: K is not a pinhole, or the pose is not finite and rigid.
    """

    K: Float
    T_world_camera: Float
    width: int
    height: int

    def __post_init__(self) -> None:
        K = np.asarray(self.K, np.float64)
        _require(K.shape == (3, 3), f"cam_K must be 3x3, got shape {K.shape}")
        pinhole = (
            bool(np.isfinite(K).all())
            and K[0, 0] > 0
            and K[1, 1] > 0
            and bool(np.allclose([K[0, 1], K[1, 0], K[2, 0], K[2, 1], K[2, 2] - 1], 0.0, atol=1e-9))
        )
        _require(pinhole, f"cam_K is not a pinhole [[fx,0,cx],[0,fy,cy],[0,0,1]]: {K.tolist()}")
        T = np.asarray(self.T_world_camera, np.float64)
        _require(is_rigid(T), "the camera pose is not a rigid transform (rotation must be orthonormal, all finite)")
        _require(self.width > 0 and self.height > 0, f"image size must be positive, got {self.width}x{self.height}")
        _freeze(self, K=K, T_world_camera=T)


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
        _require(min(measures) > 0, f"a gripper's measures must be positive, got {measures}")


@dataclass(frozen=True, eq=False)
class Frame:
    """One posed image. A current frame has depth; the goal needs none.

    Attributes:
        index: image id inside its capture.
        rgb: (H, W, 3) uint8.
        camera: the camera that took it.
        depth: (H, W) float32 metres along z, 0 where nothing was measured; None for a goal image.
        true_masks: object id -> (H, W) bool visible mask, where the truth is known; else None.

    Raises:
        ToolkitError: an array has another size or type than its camera says.
    """

    index: int
    rgb: Image
    camera: Camera
    depth: Float | None = None
    true_masks: Mapping[int, Mask] | None = None

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        _require(
            self.rgb.shape == (*size, 3) and self.rgb.dtype == np.uint8,
            f"frame {self.index}: rgb must be uint8 {(*size, 3)}, got {self.rgb.dtype} {self.rgb.shape}",
        )
        _freeze(self, rgb=self.rgb)
        if self.depth is not None:
            _require(self.depth.shape == size, f"frame {self.index}: depth must be {size}, got {self.depth.shape}")
            _require(
                bool(np.isfinite(self.depth).all()) and bool((self.depth >= 0).all()),
                f"frame {self.index}: depth must be finite and not negative",
            )
            _freeze(self, depth=np.asarray(self.depth, np.float32))
        for object_id, mask in (self.true_masks or {}).items():
            _require(
                mask.shape == size and mask.dtype == np.bool_,
                f"frame {self.index}: mask of object {object_id} must be bool {size}",
            )


@dataclass(frozen=True, eq=False)
class Segment:
    """One object's mask in one image, as a segmenter returns it.

    Attributes:
        mask: (H, W) bool, at least one pixel.
        score: 0..1, the segmenter's own confidence.
    """

    mask: Mask
    score: float = 1.0

    def __post_init__(self) -> None:
        _require(self.mask.ndim == 2 and self.mask.dtype == np.bool_, "a segment's mask must be a 2D bool array")
        _require(bool(self.mask.any()), "a segment's mask must not be empty")
        _freeze(self, mask=self.mask)

    @property
    def bbox_xyxy(self) -> tuple[int, int, int, int]:
        """Tight box (x0, y0, x1, y1) in pixels, x1 and y1 inclusive."""
        columns = np.flatnonzero(self.mask.any(axis=0))
        rows = np.flatnonzero(self.mask.any(axis=1))
        return int(columns[0]), int(rows[0]), int(columns[-1]), int(rows[-1])


@dataclass(frozen=True, eq=False)
class Crop:
    """A masked square crop of one region: the input of descriptors and matchers (Eq. global_description, 2D_match).

    Attributes:
        image: (S, S, 3) uint8, black outside the mask.
        mask: (S, S) bool.
        scale: crop pixels per image pixel.
        origin_xy: (2,) image coordinates, in pixels, of the crop's pixel (0, 0).
    """

    image: Image
    mask: Mask
    scale: float
    origin_xy: Float

    def __post_init__(self) -> None:
        size = self.image.shape[0]
        _require(self.image.shape == (size, size, 3) and self.image.dtype == np.uint8, "a crop is uint8 (S, S, 3)")
        _require(self.mask.shape == (size, size) and self.mask.dtype == np.bool_, "a crop's mask is bool (S, S)")
        _require(self.scale > 0, "a crop's scale must be positive")
        _freeze(self, image=self.image, mask=self.mask, origin_xy=np.asarray(self.origin_xy, np.float64))

    def to_image(self, crop_xy: Float) -> Float:
        """Take (N, 2) crop pixels to (N, 2) pixels of the image the crop was cut from."""
        return np.asarray(crop_xy, np.float64) / self.scale + self.origin_xy


@dataclass(frozen=True, eq=False)
class Region:
    """An object region o_k^i of a current frame (Sec. Method A): segment and point cloud in world coordinates.

    Attributes:
        frame_index: index of the frame it was seen in.
        segment: the mask in that frame.
        points: (N, 3) float32 world coordinates, metres.
        pixels: (N, 2) int32 (x, y) of every point, row-major order.
        observation: (3,) float64 unit vector from the cloud's mean to the camera (Eq. obs_pose).
    """

    frame_index: int
    segment: Segment
    points: Float
    pixels: NDArray[np.int32]
    observation: Float

    def __post_init__(self) -> None:
        n = len(self.points)
        _require(self.points.shape == (n, 3) and n > 0, "a region needs at least one point, shape (N, 3)")
        _require(self.pixels.shape == (n, 2), f"a region's pixels must be ({n}, 2), got {self.pixels.shape}")
        _require(abs(float(np.linalg.norm(self.observation)) - 1.0) < 1e-6, "the observation vector must be a unit")
        _freeze(self, points=self.points, pixels=self.pixels, observation=self.observation)

    @property
    def centroid(self) -> Float:
        """(3,) float64 mean of the points, metres."""
        return np.asarray(self.points.mean(axis=0, dtype=np.float64))


@dataclass(frozen=True, eq=False)
class Matches:
    """2D-2D correspondences between a query crop and a reference crop, in crop pixels.

    Attributes:
        query_xy: (M, 2) float64.
        reference_xy: (M, 2) float64.
        scores: (M,) float64 in 0..1, higher is better.
    """

    query_xy: Float
    reference_xy: Float
    scores: Float

    def __post_init__(self) -> None:
        m = len(self.scores)
        for name in ("query_xy", "reference_xy"):
            array = getattr(self, name)
            _require(array.shape == (m, 2), f"{name} must be ({m}, 2), got {array.shape}")
            _require(bool(np.isfinite(array).all()), f"{name} must be finite")
        _freeze(self, query_xy=self.query_xy, reference_xy=self.reference_xy, scores=self.scores)

    def __len__(self) -> int:
        return len(self.scores)

    @classmethod
    def empty(cls) -> Matches:
        """No correspondence at all."""
        return cls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))


@dataclass(frozen=True, eq=False)
class Correspondences:
    """2D-3D correspondences of one object: the PnP problem (M_3D of the paper).

    Attributes:
        points: (N, 3) float64, metres, in the world of the current scene.
        pixels: (N, 2) float64, in the goal image.
        weights: (N,) float64 in 0..1, the matches' scores.
        camera: the goal camera; its pose is what a prior about the table is stated in.
    """

    points: Float
    pixels: Float
    weights: Float
    camera: Camera

    def __post_init__(self) -> None:
        n = len(self.points)
        _require(self.points.shape == (n, 3), f"points must be (N, 3), got {self.points.shape}")
        _require(self.pixels.shape == (n, 2), f"pixels must be ({n}, 2), got {self.pixels.shape}")
        _require(self.weights.shape == (n,), f"weights must be ({n},), got {self.weights.shape}")
        finite = all(bool(np.isfinite(a).all()) for a in (self.points, self.pixels, self.weights))
        _require(finite, "correspondences must be finite")
        _freeze(self, points=self.points, pixels=self.pixels, weights=self.weights)

    @property
    def K(self) -> Float:
        """(3, 3) float64 intrinsics of the goal camera, pixels."""
        return self.camera.K

    def __len__(self) -> int:
        return len(self.points)


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
    """

    T_goal_current: Float
    confidence: float
    equivalents: Float
    ambiguity: Ambiguity
    covariance: Float

    def __post_init__(self) -> None:
        _require(is_rigid(self.T_goal_current), "a refined motion must be a rigid transform")
        _require(0 <= self.confidence <= 1, f"a confidence must be in 0..1, got {self.confidence}")
        _freeze(self, T_goal_current=self.T_goal_current, equivalents=self.equivalents, covariance=self.covariance)


@dataclass(frozen=True, eq=False)
class PnPSolution:
    """A solved PnP problem.

    Attributes:
        T_camera_world: (4, 4) float64 that takes the correspondences' points into the goal camera.
        inliers: (N,) bool.
        covariance: (6, 6) float64 of (turn, shift) in the goal's world about the points' mean, rad^2 and m^2; rows and
            columns of what was held fixed are 0. None where the solver gives none.
    """

    T_camera_world: Float
    inliers: Mask
    covariance: Float | None = None

    def __post_init__(self) -> None:
        _require(is_rigid(self.T_camera_world), "a PnP solution must be a rigid transform")
        _freeze(self, T_camera_world=self.T_camera_world, inliers=self.inliers)
        if self.covariance is not None:
            _freeze(self, covariance=self.covariance)


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
        _require((self.T_goal_current is None) != (self.failure is None), "an estimate has a motion or a failure")
        if self.T_goal_current is not None:
            _require(is_rigid(self.T_goal_current), "T_goal_current must be a rigid transform")

    @property
    def status(self) -> str:
        """`estimated`, `abstained` or `failed` (poses.json)."""
        if self.failure is None:
            return "estimated"
        return "abstained" if isinstance(self.failure, Abstention) else "failed"

    def move(self, points: Float) -> Float:
        """Apply the motion to (N, 3) world points. Raises ToolkitError when there is none."""
        if self.T_goal_current is None:
            raise ToolkitError("a failed estimate moves nothing")
        return transform_points(self.T_goal_current, points)


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """What scoring needs to know of an object (BOP models_info, in metres).

    Attributes:
        object_id: BOP object id.
        name: the object's name.
        box_min: (3,) smallest corner of the axis-aligned box, model coordinates.
        box_size: (3,) its size.
        diameter: largest distance between two model points.
        discrete_symmetries: (S, 4, 4) rigid symmetries besides the identity.
        continuous_axes: (A, 6) axis (unit) and a point on it, of continuous rotations.
    """

    object_id: int
    name: str
    box_min: Float
    box_size: Float
    diameter: float
    discrete_symmetries: Float
    continuous_axes: Float

    @property
    def center(self) -> Float:
        """(3,) centre of the axis-aligned box, where translations are scored."""
        return self.box_min + 0.5 * self.box_size


@dataclass(frozen=True, eq=False)
class TrueObject:
    """Where one object really is, before and after.

    Attributes:
        model: the object.
        T_world_current: (4, 4) model to world in the current scene, metres.
        T_world_goal: (4, 4) model to world in the goal scene, metres.
        instance_id: id of the object inside its scene (unique even where two share a model).
    """

    model: ObjectModel
    T_world_current: Float
    T_world_goal: Float
    instance_id: int

    @property
    def T_goal_current(self) -> Float:
        """(4, 4) the true motion in world coordinates."""
        return self.T_world_goal @ np.linalg.inv(self.T_world_current)


@dataclass(frozen=True, eq=False)
class Capture:
    """One task: posed RGB-D frames of the current scene, one RGB image of the goal, and the truth where known.

    Attributes:
        name: the capture folder's name.
        current: the current scene's frames.
        goal: the goal image.
        truth: true objects by instance id, or None.
        digest: sha256 of the files it was read from.
    """

    name: str
    current: tuple[Frame, ...]
    goal: Frame
    truth: Mapping[int, TrueObject] | None
    digest: str

    def __post_init__(self) -> None:
        _require(len(self.current) > 0, f"capture {self.name}: there is no current frame")
        for frame in self.current:
            _require(frame.depth is not None, f"capture {self.name}: current frame {frame.index} has no depth")
