"""What every kind of recording gives: posed images, none of which is decoded before it is chosen."""

from __future__ import annotations

import importlib
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from toolkit.data.bop.lens import Lens
from toolkit.errors import ToolkitError
from toolkit.types import Camera, Float, Frame, Image, Placed


@dataclass(frozen=True, eq=False)
class Shot:
    """One posed image of a recording.

    Attributes:
        index: its number, which it keeps in the capture.
        name: what the recording calls it.
        T_world_camera: (4, 4) float64 pose, metres, OpenCV axes.
        has_depth: whether it can be a current frame.
    """

    index: int
    name: str
    T_world_camera: Float
    has_depth: bool = True


@dataclass(frozen=True, eq=False)
class Recording:
    """Posed images in one world.

    Attributes:
        shots: in the order in which they were taken, no index twice.
        load: decodes some of them, in their order: frames without lens distortion, depth in metres.
        placed: the true objects as a shot's file has them, by instance id; None where the truth is not known.
        notes: what was left out, in sentences.
    """

    shots: tuple[Shot, ...]
    load: Callable[[Sequence[Shot]], list[Frame]]
    placed: Callable[[Shot], Mapping[int, Placed]] | None = None
    notes: tuple[str, ...] = ()


class Importer(Protocol):
    """Reads one kind of recording."""

    @abstractmethod
    def read(self, source: Path) -> Recording:
        """What `source` holds, poses and times only.

        Raises:
            ToolkitError: it is not of this kind, damaged, or a setting does not fit it.
        """
        ...


def pinhole_frame(shot: Shot, rgb: Image, depth: Float | None, K: Float, distortion: tuple[float, ...] = ()) -> Frame:
    """A shot's pixels as a frame, lens distortion taken out.

    Args:
        shot: whose pixels they are.
        rgb: (H, W, 3) uint8.
        depth: (H, W) float32 metres along z, 0 where nothing was measured.
        K: (3, 3) in pixels; (0, 0) is the centre of the top-left one.
        distortion: in OpenCV's order; none where it is empty.

    Raises:
        ToolkitError: sizes differ, or K or distortion is not of these pixels.
    """
    height, width = rgb.shape[:2]
    lens = Lens.of(K, distortion, (height, width), f"image '{shot.name}'")
    camera = Camera(K, shot.T_world_camera, width, height)
    if depth is not None and depth.shape != (height, width):
        raise ToolkitError(
            f"image '{shot.name}' is {width}x{height}, but its depth is {depth.shape[1]}x{depth.shape[0]}; "
            "align depth to colour, pixel for pixel"
        )
    if lens is None:
        return Frame(shot.index, rgb, camera, depth)
    return Frame(shot.index, lens.color(rgb), camera, None if depth is None else lens.nearest(depth))


def library(module: str, extra: str, what: str) -> Any:
    """A library that is imported when it is needed.

    Args:
        module: its name in Python.
        extra: the extra of this package that installs it.
        what: what needs it.

    Raises:
        ToolkitError: it is not installed, or the system lacks what it is linked to.
    """
    needs = f"{what} needs {module.partition('.')[0]}"
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ToolkitError(f"{needs}: pip install 'rearrange-toolkit[{extra}]'") from error
    except ImportError as error:
        raise ToolkitError(
            f"{needs}, which is installed and cannot be loaded ({error}): install what it lacks"
        ) from error
