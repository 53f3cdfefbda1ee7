"""Camera poses corrected by the table, which stands still between all images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

from toolkit.perception.registration.shared.stated import StatedConfig
from toolkit.perception.registration.tracking.adjust import adjust
from toolkit.perception.registration.tracking.tracks import Tabletop, find_tabletop, follow
from toolkit.perception.stages import Registration
from toolkit.registry import Plugin
from toolkit.types import Frame


class TableConfig(StatedConfig):
    """Settings of the `table` registration."""


class TableRegistration(Plugin[TableConfig], Registration):
    """Follows points of the bare table between all images and adjusts the poses until they lie at one place.

    An arm's poses are off by millimetres. Current frames that disagree blur the fused models, and a goal camera that is
    off shifts every motion. The table is a plane that depth finds, it is the same in all images, and it does not move
    with the objects. Without texture on it nothing is followed, and poses stay as stated.

    Both methods raise ToolkitError where no frame's depth shows a table.
    """

    stage = "registration"
    name = "table"

    def __init__(self, config: TableConfig | None = None) -> None:
        super().__init__(config)
        self._last: tuple[list[Frame], Tabletop] | None = None

    def register(self, frames: Sequence[Frame]) -> list[Frame]:
        tabletop = find_tabletop(frames)
        views = tabletop.top_views(frames)
        tracks = follow(tabletop, views, list(combinations(range(len(frames)), 2)))
        cameras = [frame.camera for frame in frames]
        adjusted = adjust(cameras, tracks, tabletop.T_world_table, [True] * len(frames), self.config.sigma)
        registered = [replace(frame, camera=camera) for frame, camera in zip(frames, adjusted, strict=True)]
        self._last = registered, tabletop
        return registered

    def locate(self, goal: Frame, frames: Sequence[Frame]) -> Frame:
        tabletop = self._tabletop(frames)
        views = [*tabletop.top_views(frames), tabletop.top_view(goal, None)]
        n = len(frames)
        tracks = follow(tabletop, views, [(i, n) for i in range(n)])
        cameras = [*(frame.camera for frame in frames), goal.camera]
        adjusted = adjust(cameras, tracks, tabletop.T_world_table, [False] * n + [True], self.config.sigma)
        return replace(goal, camera=adjusted[-1])

    def _tabletop(self, frames: Sequence[Frame]) -> Tabletop:
        """What `register` found in these very frames, which it takes half its time to find."""
        if self._last is not None and self._last[0] == list(frames):
            return self._last[1]
        return find_tabletop(frames)
