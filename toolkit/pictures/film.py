"""Films of rearrangements: the goal beside the table as it changes, as MP4; and its objects' poses, for Rerun."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, runtime_checkable

import cv2
import numpy as np

from toolkit.data.objects import ObjectAsset
from toolkit.data.tabletop import TabletopScene
from toolkit.errors import ToolkitError
from toolkit.pictures.drawing import scaled_to_height
from toolkit.pictures.recording import load_rerun, log_box, log_camera, log_picture, recording, transform
from toolkit.types import Float, Image

_FRAMES_PER_S = 25
_HELD_FRAMES = 2 * _FRAMES_PER_S
"""The end stays in the picture for two seconds."""

_TEXTURE_PX = 256

_CODEC = cv2.VideoWriter.fourcc(*"vp09")
"""VP9: free, and played by browsers; OpenCV's wheels carry no H.264 encoder."""


@runtime_checkable
class Filmable(Protocol):
    """An executor that can be filmed."""

    on_step: Callable[[], None] | None
    """Called at every step of a motion."""

    moves: int
    """Moves begun so far."""

    def snapshot(self) -> Image:
        """(H, W, 3) uint8 picture of the table now."""
        ...

    def goal_snapshot(self) -> Image:
        """(H, W, 3) uint8 picture of the table as it should become, seen from where `snapshot` is."""
        ...

    def goal_picture(self) -> Image:
        """(H, W, 3) uint8 goal image of the task."""
        ...

    def state(self) -> Mapping[int, Float] | None:
        """True (4, 4) model-to-world poses by instance id where they are known, as an executor's."""
        ...


class Film:
    """Films an executor for as long as the `with` block lasts.

    Args:
        executor: what to film.
        path: the MP4 file.
        every: steps of motion per frame.
        on_frame: called at every frame with its time in the film, seconds.

    Raises:
        ToolkitError: the file cannot be written.
    """

    def __init__(
        self, executor: Filmable, path: Path, every: int = 3, on_frame: Callable[[float], None] | None = None
    ) -> None:
        self._executor = executor
        self._path = path
        self._every = every
        self._on_frame = on_frame
        self._steps = self._frames = 0
        self._writer: cv2.VideoWriter | None = None

    def __enter__(self) -> Film:
        self._executor.on_step = self._step
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.on_step = None
        if kind is None:
            self._shoot(_HELD_FRAMES)
        if self._writer is not None:
            self._writer.release()

    def _step(self) -> None:
        if self._steps % self._every == 0:
            self._shoot()
        self._steps += 1

    def _shoot(self, frames: int = 1) -> None:
        if self._on_frame is not None:
            self._on_frame(self._frames / _FRAMES_PER_S)
        self._frames += frames
        now = self._executor.snapshot()
        goal = scaled_to_height(self._executor.goal_snapshot(), now.shape[0])
        picture = np.hstack([goal, now])
        moves = self._executor.moves
        for text, x in (("goal", 0), (f"move {moves}" if moves else "before", goal.shape[1])):
            cv2.putText(picture, text, (x + 16, 32), cv2.FONT_HERSHEY_SIMPLEX, 0.9, (255, 255, 255), 2, cv2.LINE_AA)
        if self._writer is None:
            height, width = picture.shape[:2]
            self._writer = cv2.VideoWriter(str(self._path), _CODEC, _FRAMES_PER_S, (width, height))
            if not self._writer.isOpened():
                raise ToolkitError(f"film '{self._path}' cannot be written")
        for _ in range(frames):
            self._writer.write(np.ascontiguousarray(picture[..., ::-1]))


@contextmanager
def record_poses(executor: Filmable, scene: TabletopScene, path: Path) -> Generator[Callable[[float], None]]:
    """A Rerun recording of a scene's objects over a film's time, for as long as the `with` block lasts.

    `table/<object>` are the meshes, which move; `goal/<object>` boxes where they are to go; `goal/camera` the image.

    Args:
        executor: what is filmed.
        scene: its task.
        path: the .rrd file.

    Yields:
        What `Film` calls at every frame.

    Raises:
        ToolkitError: rerun is not installed, or the file cannot be written.
    """
    rr = load_rerun()
    with recording(path, f"film of scene {scene.number}") as stream:
        stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        log_camera(stream, rr, "goal/camera", scene.goal_camera)
        for number, truth in scene.truth.items():
            log_box(stream, rr, f"goal/{number}", truth.model, truth.T_world_goal)
        for number, asset in enumerate(scene.assets):
            mesh = rr.Asset3D(contents=_small_glb(asset), media_type="model/gltf-binary")
            stream.log(f"table/{number}", mesh, static=True)
        shown: dict[int, Float] = {}

        def on_frame(seconds: float) -> None:
            if not shown:
                log_picture(stream, rr, "goal/camera/rgb", executor.goal_picture())
            stream.set_time("film", duration=seconds)
            for number, T in (executor.state() or {}).items():
                if number not in shown or not np.array_equal(shown[number], T):
                    shown[number] = T.copy()
                    stream.log(f"table/{number}", transform(rr, T))

        yield on_frame


def _small_glb(asset: ObjectAsset) -> bytes:
    """An object's mesh with its texture made small, as binary glTF."""
    # Pillow comes with rerun; trimesh packs textures with it.
    import trimesh
    from PIL import Image as Pictures
    from trimesh.visual.material import PBRMaterial

    mesh: Any = trimesh.load(asset.mesh, force="mesh", process=False)
    texture = Pictures.open(asset.texture).convert("RGB")
    texture.thumbnail((_TEXTURE_PX, _TEXTURE_PX))
    packed = BytesIO()
    texture.save(packed, "JPEG")
    image = Pictures.open(packed)
    mesh.visual.material = PBRMaterial(baseColorTexture=image, metallicFactor=0.0)
    return mesh.export(file_type="glb")
