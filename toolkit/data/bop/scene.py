"""One scene of a capture, current/ or goal/: its JSON files, and its frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from toolkit.data.bop.depth import far_plane, metres
from toolkit.data.bop.images import DEPTHS, PICTURES, ImageFolder, read_color, read_depth
from toolkit.data.bop.lens import Lens
from toolkit.data.bop.masks import MaskFolder
from toolkit.data.bop.notes import Notes
from toolkit.data.bop.orientation import upright
from toolkit.data.bop.poses import world_to_camera
from toolkit.data.bop.schemas import CameraEntry, TrueEntry, read_cameras, read_truth
from toolkit.data.bop.truth import instance_ids
from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.types import Camera, Float, Frame

_MASKS = "mask_visib"


@dataclass(frozen=True)
class SceneFolder:
    """What the JSON files of a scene say.

    Attributes:
        path: the scene's folder.
        cameras: by image id.
        truth: the objects of every image in `cameras`, or None where scene_gt.json is not there.
        visible: mask_visib/, where it is there: true masks if `truth` is known, else a user's own.
        own: another folder with a user's own masks.
    """

    path: Path
    cameras: Mapping[int, CameraEntry]
    truth: Mapping[int, list[TrueEntry]] | None
    visible: MaskFolder | None
    own: MaskFolder | None

    @staticmethod
    def read(
        path: Path, masks: Path | None, notes: Notes, worlds: Mapping[int, TrueEntry] | None = None
    ) -> SceneFolder:
        """Read them; raises ToolkitError where one is missing, damaged, or not as its schema.

        Args:
            path: the scene's folder.
            masks: a folder with a user's own masks.
            notes: is told what is not used.
            worlds: by image, the object whose coordinates are the world (`read_cameras`).
        """
        cameras = read_cameras(path / "scene_camera.json", worlds)
        truth_path = path / "scene_gt.json"
        truth = read_truth(truth_path, cameras) if truth_path.exists() else None
        notes.add_unknown_keys(path / "scene_camera.json", cameras.values())
        notes.add_unknown_keys(truth_path, [entry for entries in (truth or {}).values() for entry in entries])
        visible, own = (MaskFolder.of(f) if f and f.is_dir() else None for f in (path / _MASKS, masks))
        if own is not None and not own.labels and not own.objects:
            raise ToolkitError(
                f"'{own.path}' holds no mask; they are label images IMAGE.png, or IMAGE_OBJECT.png, one per object"
            )
        return SceneFolder(path, cameras, truth, visible, own)

    def where(self, image: int) -> str:
        """What answers about an image's camera begin with."""
        return f"'{self.path / 'scene_camera.json'}', image {image}"

    @property
    def _own_masks(self) -> MaskFolder | None:
        """Masks that are not true ones."""
        return self.own or (self.visible if self.truth is None else None)

    def goal_frames(self, notes: Notes) -> list[Frame]:
        """Every frame without depth; raises ToolkitError as `load_capture`."""
        return [replace(frame, depth=None) for frame in self._frames({}, notes)]

    def current_frames(self, notes: Notes) -> list[Frame]:
        """The frames that have depth; the others are left out by name. Raises ToolkitError as `load_capture`."""
        folder = ImageFolder.of(self.path / "depth", DEPTHS)
        files = {image: folder.find(image) for image in self.cameras}
        for count, image in enumerate(image for image, file in files.items() if file is None):
            if count == 0:
                notes.add(f"current frame {image} is left out: {folder.missing(image)}")
            else:
                notes.add(f"others without a depth image in '{folder.path}' are left out as well", image)
        found = {image: file for image, file in files.items() if file is not None}
        if not found:
            raise ToolkitError(f"no current frame has depth: {folder.missing(next(iter(self.cameras)))}")
        frames = self._frames(found, notes)
        planes = {plane for frame in frames if (plane := far_plane(_depth(frame))) is not None}
        for plane in sorted(planes):
            notes.add(f"depth of {plane:.4g} m, far behind all else and in many holes, is taken as not measured")
        if planes:
            frames = [
                replace(frame, depth=np.where(np.isin(_depth(frame), list(planes)), np.float32(0), _depth(frame)))
                for frame in frames
            ]
        measured = [frame for frame in frames if _depth(frame).any()]
        if not measured:
            raise ToolkitError(f"'{folder.path}': every depth image is zero everywhere; nothing was measured")
        for frame in (frame for frame in frames if not _depth(frame).any()):
            notes.add("current frames with depth of zero everywhere are left out: nothing was measured", frame.index)
        return measured

    def _frames(self, depths: Mapping[int, Path], notes: Notes) -> list[Frame]:
        """The frames of images in `depths`; where it is empty, of all images, without depth."""
        pictures = ImageFolder.of(self.path / "rgb", PICTURES)
        for image in sorted(pictures.files.keys() - self.cameras.keys()):
            notes.add(f"'{pictures.path}' holds pictures that scene_camera.json does not list: not used", image)
        images = list(depths or self.cameras)
        frames = [self._frame(image, pictures, depths.get(image), notes) for image in images]
        if self._own_masks is not None:
            for image in (frame.index for frame in frames if not frame.own_masks):
                notes.add(f"'{self._own_masks.path}' has no mask: images are taken to show no object", image)
        return frames

    def _frame(self, image: int, pictures: ImageFolder, depth_path: Path | None, notes: Notes) -> Frame:
        entry, where = self.cameras[image], self.where(image)
        path = pictures.find(image)
        if path is None:
            raise ToolkitError(pictures.missing(image))
        stored, orientation = read_color(path)
        rgb = upright(stored, orientation, entry, path, image, notes)
        height, width = size = rgb.shape[:2]
        expected = (entry.width or width, entry.height or height)
        if expected != (width, height):
            raise ToolkitError(
                f"'{path}' is {width}x{height}, but its camera says {expected[0]}x{expected[1]}; "
                "give the size, and the cam_K, of the picture as it is stored"
            )
        K = np.array(entry.cam_K).reshape(3, 3)
        if not 0 <= K[0, 2] < width or not 0 <= K[1, 2] < height:
            raise ToolkitError(
                f"'{path}' is {width}x{height}, but cam_K has its centre at {K[0, 2]:g}, {K[1, 2]:g}; "
                "cam_K must be that of the picture's size"
            )
        try:
            camera = Camera(K, invert(world_to_camera(entry, where)), width, height)
            lens = Lens.of(K, entry.cam_dist, size, where)
        except ToolkitError as error:
            raise ToolkitError(str(error) if str(error).startswith(where) else f"{where}: {error}") from error
        true = None
        if self.visible is not None and self.truth is not None:
            true = self.visible.true(image, instance_ids(self.truth[image]), size, lens)
        own = true if self._own_masks is None else self._own_masks.own(image, size, lens)
        depth = None if depth_path is None else self._depth(image, depth_path, size, lens)
        return Frame(image, rgb if lens is None else lens.color(rgb), camera, depth, true, own)

    def _depth(self, image: int, path: Path, size: tuple[int, int], lens: Lens | None) -> Float:
        scale = self.cameras[image].depth_scale
        if scale is None:
            wanted = CameraEntry.model_fields["depth_scale"].description
            raise ToolkitError(f"{self.where(image)}: depth_scale is missing; it is {wanted}")
        raw = read_depth(path)
        if raw.shape != size:
            raise ToolkitError(
                f"'{path}' is {raw.shape[1]}x{raw.shape[0]}, but its colour image is {size[1]}x{size[0]}; "
                "align depth to colour, pixel for pixel"
            )
        depth = metres(raw, scale, path, self.where(image))
        return depth if lens is None else lens.nearest(depth)


def _depth(frame: Frame) -> Float:
    assert frame.depth is not None
    return frame.depth
