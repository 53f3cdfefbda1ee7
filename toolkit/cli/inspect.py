"""`toolkit list`, `show` and `doctor`: what there is."""

from __future__ import annotations

import json
from inspect import getdoc
from typing import TYPE_CHECKING, Annotated, Any

import typer
from pydantic import BaseModel

from toolkit.cli.completion import implementation_names, stage_names
from toolkit.cli.console import listing, say
from toolkit.errors import ToolkitError, suggest

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    from toolkit.registry import Plugin, Registry

app = typer.Typer()

_EXPERIMENTS = "experiments"
_PARTS = ("dataset", "pipeline", "rearrange")


def _listed(incomplete: str) -> list[str]:
    return [*stage_names(incomplete), *([_EXPERIMENTS] if _EXPERIMENTS.startswith(incomplete) else [])]


def _shown(incomplete: str) -> list[str]:
    return [*stage_names(incomplete), *(part for part in _PARTS if part.startswith(incomplete))]


@app.command("list")
def list_what(
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="STAGE", autocompletion=_listed, help="A stage, or 'experiments'; all stages when left out."
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
def show(
    what: Annotated[
        str,
        typer.Argument(
            metavar="STAGE", autocompletion=_shown, help="A stage, or 'dataset', 'pipeline' or 'rearrange'."
        ),
    ],
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", autocompletion=implementation_names, help="An implementation, e.g. sift."),
    ] = None,
) -> None:
    """Show one implementation, or a part of an experiment: what it does, and every setting with default and meaning."""
    from rich.text import Text

    if what in _PARTS:
        if name is not None:
            raise ToolkitError(f"'{what}' is a part of every experiment, not a stage; leave '{name}' out")
        _show_part(what)
        return
    plugin = _implementation(what, name)
    say(Text.assemble((f"{what} {name}", "bold"), f"  version {plugin.version}  ({plugin.__module__})"))
    say(Text(getdoc(plugin) or ""))
    if plugin.Config.model_fields:
        say(_settings(plugin.Config))
    _show_weights(plugin)


@app.command()
def doctor() -> None:
    """Say what this machine has: versions, cores, renderer, cache, and every plugin that cannot be loaded."""
    from toolkit.cli.doctor import diagnose

    for line in diagnose():
        say(line)


def _implementation(stage: str, name: str | None) -> type[Plugin]:
    from toolkit.stages import REGISTRIES

    if stage not in REGISTRIES:
        raise ToolkitError(f"unknown stage '{stage}'{suggest(stage, [*REGISTRIES, *_PARTS])}")
    registry = REGISTRIES[stage]
    if name is None:
        raise ToolkitError(f"say which {stage}: {', '.join(registry.names())}")
    return registry.get(name)


def _show_part(part: str) -> None:
    from toolkit.harness.experiment import PARTS

    say(f"The part `{part}:` of an experiment; on the command line --set {part}.SETTING=VALUE", _settings(PARTS[part]))


def _settings(model: type[BaseModel]) -> Table:
    """Every setting of a model with its default and meaning; of a slot, where to find what may fill it."""
    from toolkit.slots import REARRANGE_SLOTS, SLOTS

    slots = SLOTS | REARRANGE_SLOTS
    table = listing("setting", "default", "meaning", typed=("setting",))
    for key, info in model.model_fields.items():
        default = "required" if info.is_required() else _in_yaml(info.get_default(call_default_factory=True))
        meaning = info.description or (f"Fills this slot: see `toolkit list {slots[key]}`." if key in slots else "")
        table.add_row(key, default, meaning)
    return table


def _in_yaml(value: Any) -> str:
    """A default as it would stand in an experiment."""
    if isinstance(value, BaseModel):
        value = value.model_dump(mode="json")
        value = value["name"] if value.keys() == {"name"} else value
    if value is None:
        return "–"
    return value if isinstance(value, str) else json.dumps(value, default=str)


def _show_weights(plugin: type[Plugin]) -> None:
    from toolkit.weights.resolve import find_card

    for card in map(find_card, plugin.weights):
        terms = f"{card.licence}, non-commercial" if card.non_commercial else card.licence
        say(f"weights {card.name}: {terms}; {card.size_mb:.1f} MB; {card.citation}")


def _implementations(registries: list[Registry[Any]]) -> Table:
    table = listing("stage", "name", "from", "what it is", typed=("stage", "name"))
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
    from toolkit.settings import read_settings, shipped_settings

    paths = shipped_settings()
    (folder,) = {path.parent for path in paths.values()}
    table = listing("name", "what it is", "file", typed=("name", "file"))
    for name, path in paths.items():
        table.add_row(name, read_settings(path, "experiment", "a description")["description"], path.name)
    say(table, f"Files: {folder}")
