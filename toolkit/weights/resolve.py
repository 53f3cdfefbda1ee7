"""From a weight card to a file: the path given, $TOOLKIT_WEIGHTS, the cache, then the card's sources."""

from __future__ import annotations

import hashlib
import os
from functools import lru_cache
from pathlib import Path

from toolkit.errors import ToolkitError, suggest
from toolkit.paths import cache_root
from toolkit.weights.cards import CARDS, WeightCard
from toolkit.weights.sources import fetch, shipped_file


def resolve_weights(wanted: str | WeightCard, given: Path | None = None) -> Path:
    """Find a checkpoint, fetching it when it is nowhere on this machine.

    Args:
        wanted: a card's name, or a card of a plugin's own.
        given: a file the user names; used instead of the card's own, and not checked against its digest.

    Raises:
        ToolkitError: no card has that name, the file given does not exist, the file found has another digest than its
            card, or no source delivers it; the message says which file to put where.
    """
    if given is not None:
        if not given.is_file():
            raise ToolkitError(f"weights file '{given}' does not exist")
        return given
    card = wanted if isinstance(wanted, WeightCard) else find_card(wanted)
    found = find_weights(card)
    if found is None:
        found = _fetch(card)
    elif not _is_intact(card, found):
        raise ToolkitError(
            f"weights '{found}' are damaged or not '{card.name}': their sha256 differs from the card's; "
            "remove the file, and the next command fetches it again"
        )
    _complete(card, found)
    return found


def resolve_folder(name: str, given: Path | None = None) -> Path:
    """Find the folder of a checkpoint with companions, as `resolve_weights`; a folder given must exist."""
    if given is None:
        return resolve_weights(name).parent
    if not given.is_dir():
        raise ToolkitError(f"weights folder '{given}' does not exist")
    return given


def find_card(name: str) -> WeightCard:
    """The card called `name`; where there is none, raises ToolkitError and suggests the nearest name."""
    if name not in CARDS:
        raise ToolkitError(f"unknown weights '{name}'{suggest(name, sorted(CARDS))}")
    return CARDS[name]


def find_weights(card: WeightCard) -> Path | None:
    """The card's file where this machine has it, unchecked; nothing is fetched."""
    kept = (folder / card.file for folder in weight_folders())
    shipped = (shipped_file(source) for source in card.sources)
    return next((path for path in (*kept, *shipped) if path is not None and path.is_file()), None)


def weight_folders() -> list[Path]:
    """Folders in which checkpoints are looked for, in this order; what is fetched goes to the last."""
    named = os.environ.get("TOOLKIT_WEIGHTS")
    return [*([Path(named)] if named else []), cache_root() / "weights"]


def file_digest(path: Path) -> str:
    """sha256 of a file, hexadecimal; computed again only after the file has changed."""
    status = path.stat()
    return _digest_of_state(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=64)
def _digest_of_state(path: Path, mtime_ns: int, size: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _is_intact(card: WeightCard, path: Path) -> bool:
    return card.sha256 is None or file_digest(path) == card.sha256


def _fetch(card: WeightCard) -> Path:
    """Fetch from the first source that delivers what the card says; nothing else reaches the final name."""
    target = weight_folders()[-1] / card.file
    reasons: list[str] = []
    for source in card.sources:
        try:
            fetch(source, target, card.sha256, card.size_mb)
            return target
        except OSError as error:
            reasons.append(str(error))
    raise ToolkitError(
        f"weights '{card.name}' cannot be fetched here: {'; '.join(reasons)}; "
        f"put {card.file} into '{target.parent}' or name a folder that holds it in $TOOLKIT_WEIGHTS"
    )


def _complete(card: WeightCard, found: Path) -> None:
    """Fetch the companions that are not beside the checkpoint yet, from the first source."""
    base = card.sources[0].rpartition("/")[0]
    for name in card.companions:
        if (found.parent / name).is_file():
            continue
        try:
            fetch(f"{base}/{name}", found.parent / name)
        except OSError as error:
            raise ToolkitError(
                f"{name} of the weights '{card.name}' cannot be fetched here: {error}; put it into '{found.parent}'"
            ) from error
