"""Messages of ROS 1 and 2 as arrays: images, cameras and poses."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from toolkit.data.bop.depth import metres
from toolkit.data.importing.settings import pose
from toolkit.errors import ToolkitError
from toolkit.types import Float, Image

_COLORS: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "8UC3": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
}
"""Encodings of sensor_msgs/Image: bytes per pixel, and how OpenCV makes RGB of them."""

_DEPTHS: dict[str, tuple[str, float]] = {"16UC1": ("u2", 1.0), "mono16": ("u2", 1.0), "32FC1": ("f4", 1000.0)}
"""The same of depth (REP 118): type, and millimetres per unit."""

_LENSES = ("plumb_bob", "rational_polynomial", "")
_CONFIG_BYTES = 12
"""Before the picture in compressedDepth: the format, and two floats that floats were quantised by."""


def seconds(stamp: Any) -> float:
    """A time of ROS in seconds."""
    return float(stamp.sec) + float(stamp.nanosec) * 1e-9


def rgb_of(message: Any) -> Image:
    """(H, W, 3) uint8 of sensor_msgs/Image or CompressedImage; raises ToolkitError where it is no colour image."""
    if hasattr(message, "format"):
        bgr = cv2.imdecode(np.asarray(message.data, np.uint8), cv2.IMREAD_COLOR)
        if bgr is None:
            raise ToolkitError(f"a compressed image of format '{message.format}' cannot be decoded")
        return np.asarray(bgr[..., ::-1], np.uint8)
    if message.encoding not in _COLORS:
        raise ToolkitError(
            f"colour images are '{message.encoding}'; read are {', '.join(_COLORS)}, and compressed ones"
        )
    channels, conversion = _COLORS[message.encoding]
    pixels = _rows(message, np.dtype(np.uint8), channels)
    return np.asarray(
        pixels if conversion is None else cv2.cvtColor(np.ascontiguousarray(pixels), conversion), np.uint8
    )


def depth_of(message: Any) -> Float:
    """(H, W) float32 metres of sensor_msgs/Image or compressedDepth, 0 where nothing was measured.

    Raises:
        ToolkitError: it is no depth image.
    """
    if hasattr(message, "format"):
        return _compressed_depth(message.format, bytes(np.asarray(message.data, np.uint8)))
    if message.encoding not in _DEPTHS:
        raise ToolkitError(f"depth images are '{message.encoding}'; read are {', '.join(_DEPTHS)}, and compressedDepth")
    kind, scale = _DEPTHS[message.encoding]
    order = ">" if message.is_bigendian else "<"
    return _metres(_rows(message, np.dtype(f"{order}{kind}"), 1)[..., 0], scale)


def lens_of(info: Any, rectified: bool) -> tuple[Float, tuple[float, ...]]:
    """(3, 3) camera matrix of sensor_msgs/CameraInfo, and its distortion in OpenCV's order, empty where it has none.

    Raises:
        ToolkitError: it is not calibrated, or has a lens of another model.
    """
    own, D, P = (np.asarray(getattr(info, name, getattr(info, name.lower(), ())), np.float64) for name in "KDP")
    K = P.reshape(3, 4)[:, :3] if rectified else own.reshape(3, 3)
    if K[0, 0] <= 0:
        raise ToolkitError("CameraInfo has no focal length: the camera is not calibrated")
    if rectified or not D.any():
        return K, ()
    if info.distortion_model not in _LENSES:
        raise ToolkitError(
            f"the lens is '{info.distortion_model}'; read are {' and '.join(_LENSES[:2])}. Record rectified images "
            "(image_proc), and say --set rectified=true"
        )
    return K, tuple(D.tolist())


def pose_of(message: Any) -> Float:
    """(4, 4) pose of a PoseStamped, PoseWithCovarianceStamped, Odometry or TransformStamped.

    Raises:
        ToolkitError: it is none of these, or not rigid.
    """
    if hasattr(message, "transform"):
        at, turn = message.transform.translation, message.transform.rotation
    else:
        inner = getattr(message, "pose", None)
        inner = getattr(inner, "pose", inner)
        if inner is None:
            raise ToolkitError(f"{getattr(message, '__msgtype__', 'a message')} holds no pose")
        at, turn = inner.position, inner.orientation
    return pose((at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w), "a pose of the recording")


def stamped_pose(message: Any) -> tuple[float, Float]:
    """When a message says that something was where, in seconds, and `pose_of` it."""
    return seconds(message.header.stamp), pose_of(message)


def _rows(message: Any, kind: np.dtype[Any], channels: int) -> NDArray[Any]:
    """(H, W, channels) of an image whose rows may be padded."""
    data = np.frombuffer(np.ascontiguousarray(message.data), np.uint8)
    height, width, used = message.height, message.width, message.width * channels * kind.itemsize
    if message.step < used or len(data) < height * message.step:
        raise ToolkitError(f"an image of {width}x{height} has {len(data)} bytes, too few for '{message.encoding}'")
    rows = data[: height * message.step].reshape(height, message.step)[:, :used]
    return np.ascontiguousarray(rows).view(kind).reshape(height, width, channels)


def _compressed_depth(said: str, data: bytes) -> Float:
    raw = cv2.imdecode(np.frombuffer(data, np.uint8)[_CONFIG_BYTES:], cv2.IMREAD_UNCHANGED)
    if "compressedDepth" not in said or raw is None or raw.dtype != np.uint16:
        raise ToolkitError(f"depth of format '{said}' is not read; record the raw topic, or compressedDepth as PNG")
    if not said.startswith("32FC1"):
        return _metres(raw, 1.0)
    _, a, b = struct.unpack("<iff", data[:_CONFIG_BYTES])
    with np.errstate(divide="ignore"):
        return _metres(np.where(raw > 0, a / (raw - b), 0), 1000.0)


def _metres(raw: NDArray[Any], scale: float) -> Float:
    return metres(raw, scale, Path("depth of the recording"), "REP 118")
