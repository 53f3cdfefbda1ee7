"""Names of array types, and the checks that every value here makes of what it is given."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from toolkit.errors import ToolkitError
from toolkit.geometry import is_rigid

Float = NDArray[np.floating[Any]]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_ACCEPTED: dict[Any, str] = {
    np.uint8: "u",
    np.bool_: "b",
    np.int32: "iu",
    np.int64: "iu",
    np.float32: "fiu",
    np.float64: "fiu",
}
"""What is wanted -> kinds of arrays that are it already, or become it without loss of meaning."""


def require(condition: object, sentence: str) -> None:
    """Raise ToolkitError with `sentence` unless `condition` holds."""
    if not condition:
        raise ToolkitError(sentence)


def freeze(instance: object, **values: Any) -> None:
    """Set fields of a frozen dataclass while it is made."""
    for name, value in values.items():
        object.__setattr__(instance, name, value)


def checked(value: Any, shape: tuple[int | None, ...], dtype: type[np.generic], what: str) -> NDArray[Any]:
    """A read-only view of an array, of a shape (None: any length) and dtype, all finite.

    Images and masks must have their dtype; numbers are converted to theirs.

    Raises:
        ToolkitError: it is something else; the sentence says what is wanted and what came.
    """
    array = np.asarray(value)
    sizes = "x".join("N" if side is None else str(side) for side in shape) or "one number"
    fits = array.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, array.shape, strict=True))
    came = f"got {array.dtype} {'x'.join(map(str, array.shape)) or 'number'}"
    exact = dtype not in (np.uint8, np.bool_) or array.dtype == dtype
    wanted = f"{what} must be {np.dtype(dtype).name} {sizes}"
    require(fits and exact and array.dtype.kind in _ACCEPTED[dtype], f"{wanted}, {came}")
    view = array.astype(dtype, copy=False).view()
    require(view.dtype.kind != "f" or np.isfinite(view).all(), f"{what} must be finite, but holds NaN or infinity")
    view.flags.writeable = False
    return view


def checked_motion(value: Any, what: str) -> Float:
    """A read-only (4, 4) float64 rigid transform; raises ToolkitError for anything else."""
    T = checked(value, (4, 4), np.float64, what)
    require(is_rigid(T), f"{what} is not a rigid transform (rotation must be orthonormal, last row 0 0 0 1)")
    return T


def checked_covariance(value: Any, what: str) -> Float:
    """A read-only (6, 6) float64 covariance, symmetric, variances from 0 up; raises ToolkitError for anything else."""
    covariance = checked(value, (6, 6), np.float64, what)
    symmetric = np.allclose(covariance, covariance.T, rtol=1e-5, atol=1e-9 * np.abs(covariance).max())
    require(symmetric and (np.diagonal(covariance) >= 0).all(), f"{what} must be symmetric, with variances from 0 up")
    return covariance


def require_share(value: float, what: str) -> None:
    """Raise ToolkitError unless a number is in 0..1; NaN is not."""
    require(0 <= value <= 1, f"{what} must be in 0..1, got {value}")
