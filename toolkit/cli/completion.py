"""What the shell offers when a word is completed: names that begin like it."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import typer

from toolkit.slots import REARRANGE_SLOTS, SLOTS

_SLOTS = SLOTS | REARRANGE_SLOTS


def experiment_names(incomplete: str) -> list[str]:
    """Shipped experiments."""
    from toolkit.settings import shipped_settings

    return _that_begin(shipped_settings(), incomplete)


def stage_names(incomplete: str) -> list[str]:
    """Stages, in the order of the pipeline."""
    from toolkit.stages import REGISTRIES

    return _that_begin(REGISTRIES, incomplete)


def implementation_names(context: typer.Context, incomplete: str) -> list[str]:
    """Implementations of the stage that is named before."""
    return _implementations(context.params.get("stage") or context.params.get("what", ""), incomplete)


def implementations_of(slot: str) -> Callable[[str], list[str]]:
    """Makes what offers the implementations that may fill a slot."""

    def names(incomplete: str) -> list[str]:
        return _implementations(_SLOTS[slot], incomplete)

    return names


def import_kinds(incomplete: str) -> list[str]:
    """Kinds of recordings that captures are made of."""
    from toolkit.data.importing import IMPORTERS

    return _that_begin(IMPORTERS.names(), incomplete)


def export_kinds(incomplete: str) -> list[str]:
    """Kinds of files that results are written as."""
    from toolkit.data.exporting import EXPORTERS

    return _that_begin(EXPORTERS.names(), incomplete)


def _implementations(stage: str, incomplete: str) -> list[str]:
    from toolkit.stages import REGISTRIES

    return _that_begin(REGISTRIES[stage].names(), incomplete) if stage in REGISTRIES else []


def _that_begin(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
