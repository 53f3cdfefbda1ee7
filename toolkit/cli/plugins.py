"""`toolkit check` and `toolkit plugin`: implementations of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from toolkit.cli.console import say
from toolkit.cli.options import (
    ImplementationArgument,
    OutOption,
    PluginOption,
    SettingsOption,
    StageArgument,
    register_plugin_files,
    single_values,
)

if TYPE_CHECKING:
    from toolkit.plugin_kit.conformance import Outcome

app = typer.Typer()
plugin_app = typer.Typer(help="Implementations of your own.", no_args_is_help=True)
app.add_typer(plugin_app, name="plugin")


class CheckFailedError(Exception):
    """A plugin fails a check."""


@app.command()
def check(
    stage: StageArgument,
    name: ImplementationArgument,
    plugin: PluginOption = [],  # noqa: B006
    settings: SettingsOption = [],  # noqa: B006
) -> None:
    """Check that an implementation does what its stage asks, or `robot FOLDER`; exit code 1 where it does not."""
    from rich.table import Table
    from rich.text import Text

    outcomes = _robot_outcomes(name) if stage == "robot" else _plugin_outcomes(stage, name, plugin, settings)
    table = Table("check", "", "time", "memory", "remark", box=None, pad_edge=False)
    for outcome in outcomes:
        mark = Text("passed", style="green") if outcome.passed else Text("failed", style="red")
        memory = f"+{outcome.grown_mb:.0f} MB" if outcome.grown_mb >= 1 else ""
        table.add_row(outcome.check, mark, f"{outcome.seconds:.2f} s", memory, outcome.note)
    say(table)
    failed = [outcome for outcome in outcomes if not outcome.passed]
    if failed:
        raise CheckFailedError(
            f"{stage} '{name}' fails {len(failed)} of {len(outcomes)} checks; {failed[0].check}: {failed[0].note}"
        )
    say(f"{stage} '{name}' passes all {len(outcomes)} checks")


def _plugin_outcomes(stage: str, name: str, plugin: list[Path], settings: list[str]) -> list[Outcome]:
    from toolkit.plugin_kit.conformance import check_plugin
    from toolkit.stages import registry_of

    register_plugin_files(plugin)
    return check_plugin(registry_of(stage).get(name), single_values(settings))


def _robot_outcomes(choice: str) -> list[Outcome]:
    from toolkit.plugin_kit.conformance.robot import check_robot
    from toolkit.sim.robots import find_robot

    return check_robot(find_robot(choice))


@plugin_app.command("new")
def plugin_new(
    stage: StageArgument,
    name: Annotated[str, typer.Argument(help="The new implementation's name.")],
    out: OutOption = None,
) -> None:
    """Write a small installable plugin that works as it stands: a module, a test, a README, a pyproject.toml."""
    from toolkit.plugin_kit.scaffold import new_plugin

    folder = new_plugin(stage, name, out)
    file = folder / f"toolkit_{name}.py"
    say(f"Written: {folder}", f"Next: toolkit check {stage} {name} --plugin {file}")
