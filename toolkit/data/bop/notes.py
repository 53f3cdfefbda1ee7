"""What reading a capture has to say besides refusing it: each thing once, with the images it is about."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from toolkit.data.bop.schemas import Entry

_NAMED = 6


class Notes:
    """Sentences, in the order in which they first came up."""

    def __init__(self) -> None:
        self._images: dict[str, list[int]] = {}

    def add(self, sentence: str, image: int | None = None) -> None:
        """Note something of one image, or of the whole capture."""
        images = self._images.setdefault(sentence, [])
        if image is not None:
            images.append(image)

    def add_unknown_keys(self, path: Path, entries: Iterable[Entry]) -> None:
        """Note the keys of a file's entries that no schema knows."""
        entries = list(entries)
        unknown = sorted({key for entry in entries for key in entry.model_extra or {}})
        if unknown:
            named = ", ".join(f"'{key}'" for key in unknown[:_NAMED])
            known = ", ".join(type(entries[0]).model_fields)
            self.add(
                f"'{path}': {named} {'is' if len(unknown) == 1 else 'are'} not known, and not used; known are {known}"
            )

    def sentences(self) -> tuple[str, ...]:
        """Every sentence once, followed by its images."""
        return tuple(f"{sentence}{_listed(images)}" for sentence, images in self._images.items())


def _listed(images: list[int]) -> str:
    if not images:
        return ""
    named = ", ".join(map(str, images[:_NAMED]))
    more = f" and {len(images) - _NAMED} more" if len(images) > _NAMED else ""
    return f" (image{'s' if len(images) > 1 else ''} {named}{more})"
