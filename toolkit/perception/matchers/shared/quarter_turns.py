"""Quarter turns of the query, for matchers that tolerate little in-plane rotation."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from pydantic import Field
from typing_extensions import TypeVar

from toolkit.perception.stages import Matcher
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Crop, Float, Matches


class TurningConfig(PluginConfig):
    """Settings that every matcher with turns has."""

    rotations: Literal[1, 4] = Field(
        1, description="Number of quarter turns of the goal crop that are tried; the one that matches best is kept."
    )


@dataclass(eq=False)
class Oriented:
    """A crop's features, and those of its turns, which are made when it first is a query."""

    crop: Crop
    upright: Any
    turned: list[Any] = field(default_factory=list[Any])


TurningConfigT = TypeVar("TurningConfigT", bound=TurningConfig, default=TurningConfig, covariant=True)


class TurningMatcher(Plugin[TurningConfigT], Matcher):
    """A Matcher over `extract_upright` and `match_upright` that tries `config.rotations` turns of the query."""

    @abstractmethod
    def extract_upright(self, crops: Sequence[Crop]) -> list[Any]:
        """As `Matcher.extract`, of the crops as they are."""

    @abstractmethod
    def match_upright(self, query: Any, references: Sequence[Any]) -> list[Matches]:
        """As `Matcher.match`, of features as `extract_upright` makes them."""

    def extract(self, crops: Sequence[Crop]) -> list[Oriented]:
        """Features of every crop; turns follow when a crop is matched as a query."""
        return [Oriented(*pair) for pair in zip(crops, self.extract_upright(crops), strict=True)]

    def match(self, query: Oriented, references: Sequence[Oriented]) -> list[Matches]:
        """Match every turn of the query to all references; for each, the turn with most score is kept."""
        if not query.turned and self.config.rotations > 1:
            query.turned += self.extract_upright([turn(query.crop, k) for k in range(1, self.config.rotations)])
        upright = [reference.upright for reference in references]
        size = query.crop.image.shape[0]
        by_turn = [
            [_turned_back(matches, k, size) for matches in self.match_upright(features, upright)]
            for k, features in enumerate([query.upright, *query.turned])
        ]
        return [max(turns, key=lambda matches: float(matches.scores.sum())) for turns in zip(*by_turn, strict=True)]


def turn(crop: Crop, quarters: int) -> Crop:
    """The crop turned anticlockwise by `quarters` of 90 deg (its place in the image is not that of the turned one)."""
    image, mask = np.rot90(crop.image, quarters), np.rot90(crop.mask, quarters)
    return Crop(np.ascontiguousarray(image), np.ascontiguousarray(mask), crop.scale, crop.origin_xy)


def turn_back(xy: Float, quarters: int, size: int) -> Float:
    """Take (N, 2) pixels of a turned crop of side `size` to those of the crop before."""
    for _ in range(quarters):
        xy = np.stack([size - 1 - xy[:, 1], xy[:, 0]], axis=1)
    return xy


def _turned_back(matches: Matches, quarters: int, size: int) -> Matches:
    return Matches(turn_back(matches.query_xy, quarters, size), matches.reference_xy, matches.scores)
