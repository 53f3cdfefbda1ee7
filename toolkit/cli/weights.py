"""`toolkit weights`: checkpoints."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated

import typer

from toolkit.cli.console import listing, say
from toolkit.errors import ToolkitError

app = typer.Typer()
weights_app = typer.Typer(help="Checkpoints of the learned stages.", no_args_is_help=True)
app.add_typer(weights_app, name="weights")


@weights_app.command("list")
def weights_list() -> None:
    """List every checkpoint: which stage may use it, its licence, its size, and whether this machine has it."""
    from rich.text import Text

    from toolkit.weights.cards import CARDS
    from toolkit.weights.resolve import find_weights

    users = _users()
    table = listing("name", "for", "what it is, licence", "MB", "here", typed=("name", "for", "MB", "here"))
    for name, card in sorted(CARDS.items()):
        # One below the other: side by side, 80 columns would break their words.
        what = Text.assemble(
            card.architecture, "\n", (card.licence, "dim"), (" (non-commercial)" * card.non_commercial, "red")
        )
        here = "yes" if find_weights(card) else "no"
        table.add_row(name, users.get(name, ""), what, f"{card.size_mb:.{int(card.size_mb < 10)}f}", here)
    say(table)


@weights_app.command("pull")
def weights_pull(names: Annotated[list[str], typer.Argument(help="Names from `toolkit weights list`.")]) -> None:
    """Fetch checkpoints that this machine lacks, check their digests, and say where they lie."""
    from toolkit.weights.resolve import find_card, resolve_weights

    for name in names:
        find_card(name)
    for name in names:
        say(f"{name}: {resolve_weights(name)}")


@weights_app.command("where")
def weights_where(name: Annotated[str, typer.Argument(help="A name from `toolkit weights list`.")]) -> None:
    """Say where a checkpoint lies, or where it is looked for and what it is fetched from."""
    from toolkit.weights.resolve import find_card, find_weights, weight_folders

    card = find_card(name)
    found = find_weights(card)
    if found is None:
        folders = " or ".join(f"'{folder}'" for folder in weight_folders())
        say(f"not on this machine; looked for {card.file} in {folders}", *card.sources)
    else:
        say(str(found))
    say(card.citation)


def _users() -> dict[str, str]:
    """Checkpoint -> stage and name of what may use it, one below the other, for each that can be loaded."""
    from toolkit.stages import REGISTRIES

    users: dict[str, str] = {}
    for registry in REGISTRIES.values():
        for name in registry.names():
            with suppress(ToolkitError):
                for card in registry.get(name).weights:
                    users[card] = "\n".join(filter(None, (users.get(card), f"{registry.stage}\n{name}")))
    return users
