"""A scene of a BOP dataset, with its truth and models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from pydantic import Field

from toolkit.data.bop.images import DEPTHS, ImageFolder
from toolkit.data.bop.notes import Notes
from toolkit.data.bop.poses import world_to_camera
from toolkit.data.bop.scene import SceneFolder
from toolkit.data.bop.schemas import TrueEntry, read_truth
from toolkit.data.bop.truth import load_models, placed_objects
from toolkit.data.importing.recording import Importer, Recording, Shot
from toolkit.errors import ToolkitError
from toolkit.files import read_json
from toolkit.geometry import invert
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Frame, Placed

_MODELS = "models*/models_info.json"


class BopConfig(PluginConfig):
    """Settings of `Bop`."""

    world: int | None = Field(
        None, ge=0, description="obj_id whose coordinates are the world; it then counts as not moved"
    )
    models: Path | None = Field(None, description="models_info.json; the dataset's own where it is left out")


class Bop(Plugin[BopConfig], Importer):
    """A scene folder of a BOP dataset (Hodan et al., ECCV 2018), such as ycbv/test/000048; images keep their ids.

    Masks and poses are the truth of the capture where scene_gt.json, mask_visib/ and the dataset's models_info.json are
    there; two scenes of the same objects are a pair with `--goal-source`. Some scenes have no camera poses in a world,
    and worlds of two scenes may have nothing to do with each other: there, `world` names an object that stands the same
    way up in both, and its coordinates are taken for the world.
    """

    stage, name = "import kind", "bop"

    def read(self, source: Path) -> Recording:
        notes = Notes()
        poses = None if self.config.world is None else _poses_of(source, self.config.world, notes)
        scene = SceneFolder.read(source, None, notes, poses)
        depth = ImageFolder.of(source / "depth", DEPTHS)
        shots = tuple(
            Shot(
                image, f"{image:06d}", invert(world_to_camera(entry, scene.where(image))), depth.find(image) is not None
            )
            for image, entry in scene.cameras.items()
        )

        def load(chosen: Sequence[Shot]) -> list[Frame]:
            measured = _only(scene, [s for s in chosen if s.has_depth])
            frames = {f.index: f for f in measured.current_frames(Notes())} if measured.cameras else {}
            others = _only(scene, [s for s in chosen if s.index not in frames])
            frames |= {f.index: f for f in others.goal_frames(Notes())}
            return [frames[shot.index] for shot in chosen]

        path = self._models(source)
        if scene.truth is None or path is None or scene.visible is None:
            notes.add("scene_gt.json, mask_visib/ or models_info.json is not there: the capture has no truth")
            return Recording(shots, load, None, notes.sentences())
        models, truth = load_models(path), scene.truth
        if poses is not None:  # what our own captures say of an older world
            truth = {i: [e.model_copy(update={"T_world_model": None}) for e in all_of] for i, all_of in truth.items()}

        def placed(shot: Shot) -> Mapping[int, Placed]:
            image = shot.index
            return placed_objects(source / "scene_gt.json", image, truth[image], scene.cameras[image], models)

        return Recording(shots, load, placed, notes.sentences())

    def _models(self, source: Path) -> Path | None:
        """A dataset's models_info.json lies beside the folder of its scenes, a capture's beside current/."""
        if self.config.models is not None:
            return self.config.models
        scenes = source.resolve().parent
        found = [scenes / "models_info.json", *sorted(scenes.parent.glob(_MODELS))]
        return next((path for path in found if path.is_file()), None)


def _only(scene: SceneFolder, shots: Sequence[Shot]) -> SceneFolder:
    return replace(scene, cameras={shot.index: scene.cameras[shot.index] for shot in shots})


def _poses_of(source: Path, world: int, notes: Notes) -> dict[int, TrueEntry]:
    """Where one object is in every image that shows it once."""
    path = source / "scene_gt.json"
    entries = read_json(path)
    images = [int(key) for key in entries if key.isdigit()] if isinstance(entries, dict) else []
    found = {image: [e for e in all_of if e.obj_id == world] for image, all_of in read_truth(path, images).items()}
    poses = {image: own[0] for image, own in found.items() if len(own) == 1}
    for image in sorted(found.keys() - poses.keys()):
        notes.add(f"images that do not show object {world} once are left out, since it is the world", image)
    if not poses:
        raise ToolkitError(f"'{path}' has object {world} once in no image, so it cannot be the world")
    return poses
