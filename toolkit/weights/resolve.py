"""From a weight card to a file: the path given, $TOOLKIT_WEIGHTS, the cache, then the card's sources."""

from __future__ import annotations

import hashlib
import os
from functools import lru_cache
from pathlib import Path

from toolkit.errors import ToolkitError
from toolkit.paths import cache_root
from toolkit.weights.cards import CARDS, WeightCard
from toolkit.weights.download import download


def resolve_weights(name: str, given: Path | None = None) -> Path:
    """Find a checkpoint, downloading it when it is nowhere on this machine.

    Args:
        name: a card's name.
        given: a file the user names; used instead of the card's own, and not checked against its digest.

    Raises:
        ToolkitError: the file given does not exist, the file found has another digest than its card, or no source
            answers; the message says which file to put where.
    """
    if given is not None:
        if not given.is_file():
            raise ToolkitError(f"weights file '{given}' does not exist")
        return given
    card = CARDS[name]
    found = _find(card)
    if found is None:
        found = _fetch(card)
    if card.sha256 is not None and file_digest(found) != card.sha256:
        raise ToolkitError(f"weights '{found}' are damaged or not '{name}': their sha256 differs from the card's")
    return found


def file_digest(path: Path) -> str:
    """sha256 hex of a file; computed once for every state of it."""
    status = path.stat()
    return _digest_of_state(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=64)
def _digest_of_state(path: Path, mtime_ns: int, size: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _find(card: WeightCard) -> Path | None:
    named = os.environ.get("TOOLKIT_WEIGHTS")
    folders = [Path(named)] if named else []
    return next((f / card.file for f in (*folders, _cache_folder()) if (f / card.file).is_file()), None)


def _cache_folder() -> Path:
    return cache_root() / "weights"


def _fetch(card: WeightCard) -> Path:
    target = _cache_folder() / card.file
    reasons: list[str] = []
    for source in card.sources:
        try:
            download(source, target)
            return target
        except OSError as error:
            reasons.append(str(error))
    raise ToolkitError(
        f"weights '{card.name}' cannot be downloaded here ({reasons[0]}); "
        f"put {card.file} into '{target.parent}' or name a folder that holds it in $TOOLKIT_WEIGHTS"
    )
