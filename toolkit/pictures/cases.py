"""Pictures that a report shows: each as a PNG in a run's folder, with its caption as a text beside it."""

from __future__ import annotations

from pathlib import Path

from toolkit.files import write_text
from toolkit.pictures.drawing import write_png
from toolkit.results.folder import PICTURES
from toolkit.types import Image


def write_case(run: Path, name: str, picture: Image, caption: str) -> None:
    """Write RUN/pictures/<name>.png from (H, W, 3) uint8, and its caption as <name>.txt."""
    (run / PICTURES).mkdir(exist_ok=True)
    write_png(run / PICTURES / f"{name}.png", picture)
    write_text(run / PICTURES / f"{name}.txt", caption)
