"""A run's pictures as its page shows them: small enough to be sent, each with its caption."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path

import cv2

from toolkit.results.about import read_if_there
from toolkit.results.folder import PICTURES

_JPEG_QUALITY = 82


@dataclass(frozen=True)
class Case:
    """A picture, JPEG in base64, and what it shows."""

    picture: str
    caption: str


def read_cases(run: Path) -> list[Case]:
    """All pictures of a run, by name."""
    cases: list[Case] = []
    for path in sorted((run / PICTURES).glob("*.png")):
        image = cv2.imread(str(path))
        if image is not None:
            data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
            cases.append(Case(base64.b64encode(data.tobytes()).decode(), read_if_there(path.with_suffix(".txt"))))
    return cases
