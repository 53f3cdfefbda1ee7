"""`toolkit dataset`: benchmarks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from toolkit.cli.console import bars, say
from toolkit.cli.options import SettingsOption, single_values
from toolkit.parallel import cores

app = typer.Typer()
dataset_app = typer.Typer(help="Make or inspect a benchmark.", no_args_is_help=True)
app.add_typer(dataset_app, name="dataset")


@dataset_app.command("build")
def dataset_build(
    out: Annotated[Path, typer.Argument(help="Folder to write the captures to.")],
    objects: Annotated[str, typer.Option(help="'procedural', or a folder of scanned objects.")] = "procedural",
    scenes: Annotated[int, typer.Option(min=1, help="Number of scenes.")] = 150,
    seed: Annotated[int, typer.Option(min=0, help="Benchmark seed.")] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; all cores when left out.")] = None,
    settings: SettingsOption = [],  # noqa: B006
) -> None:
    """Build a tabletop benchmark: a folder of captures in the BOP layout."""
    from toolkit.data.source import build_tabletop

    config = {"objects": objects, "scenes": scenes, "seed": seed, **single_values(settings)}
    build_tabletop(config, out, workers or cores(), bars())
    say(f"Written: {out}")


@dataset_app.command("show")
def dataset_show(dataset: Annotated[Path, typer.Argument(help="A folder of captures.")]) -> None:
    """Say how a benchmark was made and what it holds, and draw its first scenes."""
    from toolkit.data.inspect import contact_sheet, describe

    for line in describe(dataset):
        say(line)
    say(f"Picture: {contact_sheet(dataset)}")
