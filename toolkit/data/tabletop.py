"""The tabletop benchmark (Sec. Experiments / Dataset): scenes as pictures, and as capture folders."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from toolkit.data import noise
from toolkit.data.bop import write_capture
from toolkit.data.cameras import jitter
from toolkit.data.objects import ObjectSet
from toolkit.data.scene import TabletopConfig, TabletopScene, draw_scene, scene_generator
from toolkit.data.scenery.background import draw_background
from toolkit.data.scenery.clutter import draw_clutter
from toolkit.data.scenery.props import AWAY
from toolkit.data.sensors import measure_depth
from toolkit.data.table import table_files, table_prop
from toolkit.errors import ToolkitError
from toolkit.sim.client import Client
from toolkit.sim.shading import Lamp, ShadowMap, Surface, draw_lamps, mirror_lamps
from toolkit.sim.world import NEAR_M, Light, World
from toolkit.types import Camera, Float, Frame, Image, Mask

_BACKGROUND = np.array([96, 100, 104], np.uint8)
_FAR_M, _ROOM_FAR_M = 4.0, 8.0
_SHADOW_EDGE_M = 0.012

Side = Literal["goal", "current"]


def build_scene(config: TabletopConfig, objects: ObjectSet, number: int, folder: Path, cache: Path) -> None:
    """Draw, render and write scene `number` as a capture folder.

    The same settings and number give the same files, in any order and on any number of workers.

    Raises:
        ToolkitError: as `draw_scene`; the renderer does not load here, or leaves out an object.
    """
    scene = draw_scene(config, objects, number, cache)
    with Studio(scene, cache) as studio:
        goal = studio.goal()
        current = studio.current(scene.current)
    _require_drawn(scene, [goal, *current])
    write_capture(folder, current, goal, scene.truth, scene.only_current, scene.only_goal)


def _require_drawn(scene: TabletopScene, frames: Sequence[Frame]) -> None:
    """Every object has a pixel in some picture: the renderer leaves out, without a word, what is too much for it."""
    drawn = {i for frame in frames for i in frame.true_masks or {}}
    for i, asset in enumerate([*scene.assets, *(asset for asset, _ in scene.goal_only)]):
        if i not in drawn:
            raise ToolkitError(
                f"scene {scene.number}: object '{asset.name}' shows in no picture: the renderer cannot draw its mesh "
                f"'{asset.mesh}'; export it again with fewer faces, or ask for fewer objects with dataset.max_objects"
            )


class Studio:
    """A scene's objects on their table, and the cameras around it; use it as a context manager.

    Noise comes from the scene's own generator: the same pictures in the same order are the same to the bit.

    Args:
        scene: what to show.
        cache: where the table's files are kept.
        near_m: its cameras see nothing nearer than this.

    Raises:
        ToolkitError: the renderer does not load here.
    """

    def __init__(self, scene: TabletopScene, cache: Path, near_m: float = NEAR_M) -> None:
        self._scene = scene
        self._conditions = scene.conditions
        self._rng = scene_generator(scene.config, scene.number, "noise")
        lit, exposed = ("light" in scene.conditions.noise, "exposure" in scene.conditions.noise)
        self._goal_light, self._light = (_draw_light(self._rng) if lit else Light() for _ in range(2))
        exposures = [noise.Exposure.draw(self._rng) if exposed else noise.Exposure() for _ in range(2)]
        self._goal_exposure, self._exposure = exposures
        self._world = World(scene.config.renderer, _ROOM_FAR_M if scene.conditions.background else _FAR_M, near_m)
        self._add_bodies(cache)
        self._lamps, self._gloss = self._draw_gloss()

    def __enter__(self) -> Studio:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the simulator."""
        self._world.close()

    @property
    def client(self) -> Client:
        """The PyBullet client, for what else is to be in its pictures."""
        return self._world.client

    def goal(self) -> Frame:
        """The goal image."""
        scene = self._scene
        gone = [AWAY] * (len(scene.assets) - len(scene.goal))
        self._arrange([*scene.goal, *gone, *(pose for _, pose in scene.goal_only)], "goal")
        look = _Look(self._goal_light, self._shadows(self._goal_light), self._goal_exposure)
        frame = self._shoot(0, scene.goal_camera, look, scene.goal_hand)
        return replace(frame, depth=None)

    def current(self, poses: Sequence[Float]) -> list[Frame]:
        """RGB-D frames from the scene's views, with every object at its (4, 4) pose."""
        self._show(poses)
        look = _Look(self._light, self._shadows(self._light), self._exposure)
        views = zip(self._scene.cameras, self._scene.hands, strict=True)
        return [self._shoot(i, camera, look, hand) for i, (camera, hand) in enumerate(views)]

    def frame(self, camera: Camera, poses: Sequence[Float]) -> Frame:
        """An RGB-D frame from anywhere, with every object at its (4, 4) pose and no hand in it."""
        self._show(poses)
        return self._shoot(0, camera, _Look(self._light, self._shadows(self._light), self._exposure), AWAY)

    def picture(self, camera: Camera, poses: Sequence[Float]) -> Image:
        """(H, W, 3) uint8 without noise, for people to look at."""
        self._show(poses)
        self._place_hand(AWAY)
        rgb, _, ids = self._world.render(camera, self._light, self._supersample)
        rgb[ids < 0] = _BACKGROUND
        return rgb

    def _add_bodies(self, cache: Path) -> None:
        """Put everything that is seen in any picture into the world."""
        scene, conditions = self._scene, self._conditions
        objects = [*scene.assets, *(asset for asset, _ in scene.goal_only)]
        clutter = draw_clutter(scene.table, conditions.clutter, self._generator("clutter"))
        room = draw_background(scene.table, self._generator("background")) if conditions.background else []
        hands = [scene.hand] if scene.hand is not None else []
        usual = conditions.table != "varied" and conditions.table_shape == "square" and not conditions.background
        with tempfile.TemporaryDirectory(prefix="toolkit-") as folder:
            if usual:
                table = table_files(conditions.table, cache)
            else:
                table = table_prop(scene.table, conditions.table, self._generator("look")).write(Path(folder), "table")
            props = [*(thing.prop for thing in clutter), *room, *hands]
            files = [prop.write(Path(folder), str(i)) for i, prop in enumerate(props)]
            bodies = self._world.add_visuals([table, *((o.mesh, o.texture) for o in objects), *files])
        self._table, self._bodies, others = bodies[0], bodies[1 : 1 + len(objects)], bodies[1 + len(objects) :]
        self._clutter = [(body, thing.presence) for body, thing in zip(others, clutter, strict=False)]
        self._hand = others[-1] if hands else None

    def _draw_gloss(self) -> tuple[list[Lamp], Float]:
        """The lamps that are mirrored, and how much every body mirrors them, by body id."""
        rng = self._generator("gloss")
        gloss = np.zeros(max(self._bodies, default=self._table) + 1, np.float32)
        gloss[self._table] = self._conditions.gloss
        gloss[self._bodies] = self._conditions.gloss * rng.uniform(0, 1, len(self._bodies)) ** 2
        return draw_lamps(rng), gloss

    def _show(self, poses: Sequence[Float]) -> None:
        self._arrange([*poses, *[AWAY] * len(self._scene.goal_only)], "current")

    def _arrange(self, poses: Sequence[Float], side: Side) -> None:
        """Put every object at a (4, 4) pose, and the flat things that lie in that scene on the table."""
        self._world.move_all(self._bodies, poses)
        for body, presence in self._clutter:
            self._world.client.place(body, np.eye(4) if presence in ("both", side) else AWAY)

    def _place_hand(self, T_world_hand: Float) -> None:
        if self._hand is not None:
            self._world.client.place(self._hand, T_world_hand)

    def _shadows(self, light: Light) -> ShadowMap | None:
        """The shadows of what stands on the table now."""
        if not self._conditions.shadows:
            return None
        self._place_hand(AWAY)
        return ShadowMap(self._world, light, _SHADOW_EDGE_M)

    def _generator(self, purpose: str) -> np.random.Generator:
        return scene_generator(self._scene.config, self._scene.number, purpose)

    @property
    def _supersample(self) -> int:
        return self._scene.config.supersample if self._scene.config.renderer == "tiny" else 1

    def _shoot(self, index: int, camera: Camera, look: _Look, T_world_hand: Float) -> Frame:
        effects = self._conditions.noise
        self._place_hand(T_world_hand)
        seen = jitter(camera, self._rng) if "pose" in effects else camera
        rgb, z, ids = self._world.render(seen, look.light, self._supersample)
        rgb[ids < 0] = _BACKGROUND
        masks: dict[int, Mask] = {i: ids == body for i, body in enumerate(self._bodies)}
        masks = {i: mask for i, mask in masks.items() if mask.any()}
        rgb = self._lit(rgb, z, ids, seen, look)
        z = measure_depth(z, rgb, float(camera.K[0, 0]), self._conditions.sensor, effects, self._rng)
        return Frame(index, self._developed(rgb, look), camera, z, masks)

    def _lit(self, rgb: Image, z: Float, ids: NDArray[np.int32], camera: Camera, look: _Look) -> Image:
        """Shadows and mirrored lamps, where the scene has them."""
        if look.shadows is None and not self._conditions.gloss:
            return rgb
        surface = Surface(z, camera)
        if look.shadows is not None:
            rgb = look.shadows.darken(rgb, surface)
        if self._conditions.gloss:
            known = (ids >= 0) & (ids < len(self._gloss))
            rgb = mirror_lamps(rgb, surface, self._lamps, np.where(known, self._gloss[ids * known], 0))
        return rgb

    def _developed(self, rgb: Image, look: _Look) -> Image:
        """What lens and sensor make of the light."""
        effects = self._conditions.noise
        if "blur" in effects:
            rgb = noise.blur(rgb, self._rng)
        if "exposure" in effects:
            rgb = look.exposure.apply(rgb)
        if "color" in effects:
            rgb = noise.color_noise(rgb, self._rng)
        return rgb


@dataclass(frozen=True)
class _Look:
    """What the pictures of one scene share."""

    light: Light
    shadows: ShadowMap | None
    exposure: noise.Exposure


def _draw_light(rng: np.random.Generator) -> Light:
    x, y = rng.uniform(-0.8, 0.8, 2)
    ambient = rng.uniform(0.45, 0.65)
    return Light((float(x), float(y), 1.0), float(ambient), float(rng.uniform(0.3, 1.0 - ambient)))
