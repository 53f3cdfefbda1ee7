"""`toolkit report`, `toolkit view` and `toolkit export`: what runs and estimates have left."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from toolkit.cli.completion import export_kinds
from toolkit.cli.console import say
from toolkit.cli.options import (
    OutOption,
    PluginOption,
    SettingsOption,
    experiment_names,
    read_cell,
    register_plugin_files,
    single_values,
)
from toolkit.errors import ToolkitError

app = typer.Typer()


@app.command()
def report(
    runs: Annotated[list[Path], typer.Argument(help="A run folder, or the shards of one experiment.")],
    out: OutOption = None,
) -> None:
    """Print a run's table again and write its report.html anew; with --out, merge shards into one run first."""
    from toolkit.harness.drive import kind_of
    from toolkit.harness.merge import merge_shards
    from toolkit.harness.runs import require_run

    for folder in runs:
        require_run(folder)
    if len(runs) > 1 and out is None:
        raise ToolkitError("several runs are merged into a new one: name its folder with --out")
    run = runs[0] if out is None else merge_shards(runs, out)
    kind_of(run).write_page(run)
    show_run(run)


@app.command()
def view(
    target: Annotated[Path, typer.Argument(help="A run folder, or a capture folder.")],
    scene: Annotated[
        int | None, typer.Argument(min=0, help="A scene of the run; its worst cases when left out.")
    ] = None,
    cell: Annotated[str | None, typer.Option(help="A cell of the run; the best when left out.")] = None,
    experiment: Annotated[
        str, typer.Option(autocompletion=experiment_names, help="What estimates a capture.")
    ] = "estimate",
    plugin: PluginOption = [],  # noqa: B006
    save: Annotated[Path | None, typer.Option("--save", help="The .rrd file; it is written and not opened.")] = None,
) -> None:
    """Record one scene for Rerun's viewer: frames, models, estimated motions and the truth; and open it."""
    from toolkit.harness.view import is_capture, open_viewer, view_capture, view_scene, worst_table

    register_plugin_files(plugin)
    if is_capture(target):
        if scene is not None or cell is not None:
            raise ToolkitError(f"'{target}' is one capture; leave SCENE and --cell out")
        file = save or Path("runs") / "view" / f"{target.resolve().name}.rrd"
        path = view_capture(target, read_cell(experiment, {}), file)
    elif scene is None:
        say(worst_table(target, cell), f"\nNext: toolkit view {target} SCENE")
        return
    else:
        path = view_scene(target, scene, cell, save)
    say(f"Written: {path}")
    if save is None and not open_viewer(path):
        say(f"No display here; where there is one: rerun {path}")


@app.command()
def export(
    kind: Annotated[str, typer.Argument(autocompletion=export_kinds, help="bop, ply or ros.")],
    result: Annotated[Path, typer.Argument(help="What `estimate` or `evaluate` wrote (--out).")],
    out: Annotated[Path, typer.Argument(help="The file to write; the folder, where there are several.")],
    settings: SettingsOption = [],  # noqa: B006
) -> None:
    """Write results as other tools read them: BOP results CSV, PLY models, PoseStamped as JSON."""
    from toolkit.data.exporting import EXPORTERS
    from toolkit.data.exporting.results import read_results
    from toolkit.files import writing

    exporter = EXPORTERS.create(kind, single_values(settings))
    results = read_results(result)
    with writing(f"'{out}'"):
        say(*exporter.write(results, out))
    say(f"Written: {out}")


def show_run(run: Path) -> None:
    """Print a run's tables, whatever its rows are, and say where its page lies."""
    from rich.console import Console

    from toolkit.harness.drive import kind_of
    from toolkit.results.folder import FIGURES, PAGE, TABLES

    kind_of(run).print(run, Console())
    say(f"\nReport: {run / PAGE}", f"For a paper: {run / TABLES} (LaTeX, CSV), {run / FIGURES} (PDF, SVG)")
