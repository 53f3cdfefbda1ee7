"""Cameras, posed images, and objects in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from toolkit.types.arrays import Float, Image, Mask, checked, checked_motion, freeze, require, require_share

_FAR_M = 100.0
"""Nothing on a table is this far away. In millimetres, nothing that a camera sees is this near."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A posed pinhole camera.

    Attributes:
        K: (3, 3) float64 intrinsics, in pixels, no skew, last row (0, 0, 1).
        T_world_camera: (4, 4) float64 rigid pose of the camera (metres), OpenCV axes.
        width: image width, pixels.
        height: image height, pixels.

    Raises:
        ToolkitError: K is not a pinhole, the pose is not finite and rigid or not in metres (100 m from the world's
            origin or more), or the size is not of whole pixels.
    """

    K: Float
    T_world_camera: Float
    width: int
    height: int

    def __post_init__(self) -> None:
        K = checked(self.K, (3, 3), np.float64, "cam_K")
        pinhole = (
            K[0, 0] > 0 and K[1, 1] > 0 and np.allclose([*K[[0, 1, 2, 2], [1, 0, 0, 1]], K[2, 2] - 1], 0, atol=1e-9)
        )
        require(pinhole, f"cam_K is not a pinhole [[fx,0,cx],[0,fy,cy],[0,0,1]]: {K.tolist()}")
        T = checked_motion(self.T_world_camera, "the camera pose")
        away = float(np.linalg.norm(T[:3, 3]))
        require(
            away < _FAR_M,
            f"the camera is {away:.0f} m from the world's origin; poses are in metres, so divide millimetres by 1000",
        )
        whole = all(side > 0 and float(side).is_integer() for side in (self.width, self.height))
        require(whole, f"image size must be whole pixels, at least 1x1, got {self.width}x{self.height}")
        freeze(self, K=K, T_world_camera=T, width=int(self.width), height=int(self.height))

    def moved(self, T: Float) -> Camera:
        """The camera as it stands in another world, into which (4, 4) `T` takes points of its own."""
        return replace(self, T_world_camera=T @ self.T_world_camera)


@dataclass(frozen=True, eq=False)
class Frame:
    """One posed image. A current frame has depth; the goal needs none.

    Attributes:
        index: image id inside its capture.
        rgb: (H, W, 3) uint8.
        camera: the camera that took it.
        depth: (H, W) float32 metres along z, 0 where nothing was measured; None for a goal image.
        true_masks: object id -> (H, W) bool visible mask, where the truth is known; else None.
        own_masks: number -> (H, W) bool mask that a user brought with the image, disjoint; None where there are none.

    Raises:
        ToolkitError: an array has another size or type than its camera says, or depth is not in metres: it is of whole
            numbers, as files hold it, or most of it is 100 or more.
    """

    index: int
    rgb: Image
    camera: Camera
    depth: Float | None = None
    true_masks: Mapping[int, Mask] | None = None
    own_masks: Mapping[int, Mask] | None = None

    def __post_init__(self) -> None:
        name, size = f"frame {self.index}", (self.camera.height, self.camera.width)
        freeze(self, rgb=checked(self.rgb, (*size, 3), np.uint8, f"{name}: rgb"))
        if self.depth is not None:
            freeze(self, depth=_checked_depth(self.depth, size, f"{name}: depth"))
        for which in ("true_masks", "own_masks"):
            masks: Mapping[int, Mask] | None = getattr(self, which)
            if masks is not None:
                what = f"{name}: mask of object"
                freeze(self, **{which: {k: checked(mask, size, np.bool_, f"{what} {k}") for k, mask in masks.items()}})

    def moved(self, T: Float) -> Frame:
        """The frame with its camera in another world, into which (4, 4) `T` takes points of its own."""
        return replace(self, camera=self.camera.moved(T))


def _checked_depth(depth: Float, size: tuple[int, int], what: str) -> Float:
    kind = np.asarray(depth).dtype
    remedy = "multiply what a file holds by its depth scale, 0.001 for millimetres"
    require(kind.kind == "f", f"{what} must be float metres, got {kind}; {remedy}")
    metres = checked(depth, size, np.float32, what)
    require((metres >= 0).all(), f"{what} must not be negative; 0 is where nothing was measured")
    some = metres[::4, ::4]
    some = some[some > 0]
    middle = float(np.median(some)) if len(some) else 0.0
    require(middle < _FAR_M, f"{what} must be in metres, but its median is {middle:.0f}; {remedy}")
    return metres


@dataclass(frozen=True, eq=False)
class Segment:
    """One object's mask in one image, as a segmenter returns it.

    Attributes:
        mask: (H, W) bool, at least one pixel.
        score: 0..1, the segmenter's own confidence.
        instance: which object of the scene it shows, the same number in every image; None where the segmenter does not
            follow objects from image to image.

    Raises:
        ToolkitError: the mask is empty or no mask, or the score is out of range.
    """

    mask: Mask
    score: float = 1.0
    instance: int | None = None

    def __post_init__(self) -> None:
        mask = checked(self.mask, (None, None), np.bool_, "a segment's mask")
        require(mask.any(), "a segment's mask must not be empty")
        require_share(self.score, "a segment's score")
        freeze(self, mask=mask)

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
        origin_xy: (2,) float64 image coordinates, in pixels, of the crop's pixel (0, 0).

    Raises:
        ToolkitError: it is not square, mask or place do not fit it, or something is seen outside the mask.
    """

    image: Image
    mask: Mask
    scale: float
    origin_xy: Float

    def __post_init__(self) -> None:
        side = len(self.image)
        image = checked(self.image, (side, side, 3), np.uint8, "a crop's image")
        mask = checked(self.mask, (side, side), np.bool_, "a crop's mask")
        red, green, blue = np.moveaxis(image, -1, 0)
        require(not ((red | green | blue) > mask * np.uint8(255)).any(), "a crop must be black outside its mask")
        require(0 < self.scale < np.inf, f"a crop's scale must be positive, got {self.scale}")
        freeze(self, image=image, mask=mask, origin_xy=checked(self.origin_xy, (2,), np.float64, "a crop's origin_xy"))

    def to_image(self, crop_xy: Float) -> Float:
        """Take (N, 2) crop pixels to (N, 2) pixels of the image the crop was cut from."""
        return np.asarray(crop_xy, np.float64) / self.scale + self.origin_xy
