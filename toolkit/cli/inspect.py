"""`toolkit list`, `show` and `doctor`: what there is."""

from __future__ import annotations

from inspect import getdoc
from typing import TYPE_CHECKING, Annotated, Any

import typer

from toolkit.cli.completion import stage_names
from toolkit.cli.console import say
from toolkit.cli.options import ImplementationArgument, StageArgument
from toolkit.errors import ToolkitError, suggest

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    from toolkit.registry import Registry

app = typer.Typer()

_EXPERIMENTS = "experiments"


def _listed(incomplete: str) -> list[str]:
    return [*stage_names(incomplete), *([_EXPERIMENTS] if _EXPERIMENTS.startswith(incomplete) else [])]


@app.command("list")
def list_what(
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="[STAGE]", autocompletion=_listed, help="A stage, or 'experiments'; all stages when left out."
        ),
    ] = None,
) -> None:
    """List every stage's implementations, and mark those that cannot be loaded; or list the shipped experiments."""
    from toolkit.stages import REGISTRIES

    if what == _EXPERIMENTS:
        _list_experiments()
    elif what is None or what in REGISTRIES:
        say(_implementations(list(REGISTRIES.values()) if what is None else [REGISTRIES[what]]))
    else:
        raise ToolkitError(f"unknown stage '{what}'{suggest(what, [*REGISTRIES, _EXPERIMENTS])}")


@app.command()
def show(stage: StageArgument, name: ImplementationArgument) -> None:
    """Show one implementation: what it does, its settings with defaults, its version, its weights."""
    from rich.table import Table
    from rich.text import Text

    from toolkit.stages import registry_of
    from toolkit.weights.resolve import find_card

    plugin = registry_of(stage).get(name)
    say(Text.assemble((f"{stage} {name}", "bold"), f"  version {plugin.version}  ({plugin.__module__})"))
    say(Text(getdoc(plugin) or ""))
    table = Table("setting", "default", "meaning")
    for key, info in plugin.Config.model_fields.items():
        default = "required" if info.is_required() else repr(info.get_default(call_default_factory=True))
        table.add_row(key, default, info.description or "")
    if plugin.Config.model_fields:
        say(table)
    for card in map(find_card, plugin.weights):
        terms = f"{card.licence}, non-commercial" if card.non_commercial else card.licence
        say(f"weights {card.name}: {terms}; {card.size_mb:.1f} MB; {card.citation}")


@app.command()
def doctor() -> None:
    """Say what this machine has: versions, cores, renderer, cache, and every plugin that cannot be loaded."""
    from toolkit.cli.doctor import diagnose

    for line in diagnose():
        say(line)


def _implementations(registries: list[Registry[Any]]) -> Table:
    from rich.table import Table

    table = Table("stage", "name", "from", "what it is")
    for registry in registries:
        for entry in registry.entries():
            table.add_row(registry.stage, entry.name, entry.origin, _summary(registry, entry.name))
    return table


def _summary(registry: Registry[Any], name: str) -> Text:
    from rich.text import Text

    try:
        return Text((getdoc(registry.get(name)) or "").partition("\n")[0])
    except ToolkitError as error:
        return Text(f"cannot be used: {error}", style="red")


def _list_experiments() -> None:
    from rich.table import Table

    from toolkit.settings import read_settings, shipped_settings

    paths = shipped_settings()
    (folder,) = {path.parent for path in paths.values()}
    table = Table("name", "what it is", "file")
    for name, path in paths.items():
        table.add_row(name, read_settings(path, "experiment", "a description")["description"], path.name)
    say(table, f"Files: {folder}")
