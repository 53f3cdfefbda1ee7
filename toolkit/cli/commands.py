"""The command line. Nothing heavy is imported before a command needs it."""

from __future__ import annotations

import inspect
import signal
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from toolkit.cli.options import (
    ExperimentArgument,
    OutOption,
    read_experiment,
    run_options,
    with_experiment_options,
    with_run_options,
)
from toolkit.errors import ToolkitError
from toolkit.parallel import cores
from toolkit.slots import REARRANGE_SLOTS, SLOTS

if TYPE_CHECKING:
    from toolkit.harness.experiment import Cell
    from toolkit.registry import Registry

app = typer.Typer(
    name="toolkit",
    help="Image-goal object rearrangement by multi-view fusion: every stage swappable, every swap measured.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
dataset_app = typer.Typer(help="Make or inspect a benchmark.", no_args_is_help=True)
app.add_typer(dataset_app, name="dataset")
weights_app = typer.Typer(help="Checkpoints of the learned stages.", no_args_is_help=True)
app.add_typer(weights_app, name="weights")
plugin_app = typer.Typer(help="Implementations of your own.", no_args_is_help=True)
app.add_typer(plugin_app, name="plugin")


@app.command()
@with_experiment_options
@with_run_options
def ablate(
    experiment: ExperimentArgument = "quick",
    attribute: Annotated[
        bool, typer.Option("--attribute", help="Put the truth in the place of one stage at a time: what each costs.")
    ] = False,
    *,
    choices: dict[str, Any],
    run: dict[str, Any],
) -> None:
    """Run an experiment's cells on the same scenes, print the table and write rows and a report."""
    from rich.console import Console

    from toolkit.harness.ablate import run_experiment
    from toolkit.harness.attribution import attribution
    from toolkit.progress import Progress

    options = run_options(choices, **run)
    loaded = read_experiment(experiment, choices)
    folder = run_experiment(attribution(loaded) if attribute else loaded, options, Progress(Console(stderr=True)))
    _show_run(folder, folder / "report.html")


@app.command()
@partial(with_experiment_options, slots=(*SLOTS, *REARRANGE_SLOTS))
@with_run_options
def rearrange(
    experiment: ExperimentArgument = "rearrange",
    film: Annotated[
        bool, typer.Option("--film", help="Film the first scene: film.mp4, and film.rrd where rerun is installed.")
    ] = False,
    *,
    choices: dict[str, Any],
    run: dict[str, Any],
) -> None:
    """Perceive, plan and move in simulation until every object stands at its goal; print how often that works."""
    from rich.console import Console

    from toolkit.harness.rearrange import run_rearrangement
    from toolkit.progress import Progress

    options = run_options(choices, **run)
    loaded = read_experiment(experiment, choices, rearranges=True)
    folder = run_rearrangement(loaded, options, Progress(Console(stderr=True)), film=film)
    _show_run(folder, folder / "report.html")


@app.command()
@with_experiment_options
def estimate(
    capture: Annotated[Path, typer.Argument(help="A capture folder (BOP scene layout).")],
    experiment: ExperimentArgument = "estimate",
    out: OutOption = None,
    *,
    choices: dict[str, Any],
) -> None:
    """Estimate the motion of every object of one capture: poses.json, and pictures to judge them by."""
    from rich.console import Console

    from toolkit.harness.estimate import estimate_folder, poses_table

    folder = out or Path("runs") / "estimate" / capture.resolve().name
    estimates = estimate_folder(capture, _single_cell(experiment, choices), folder)
    console = Console()
    console.print(poses_table(estimates))
    console.print(f"\nWritten: {folder / 'poses.json'}", highlight=False, soft_wrap=True)


@app.command()
@with_experiment_options
def evaluate(
    dataset: Annotated[Path, typer.Argument(help="A folder of captures.")],
    experiment: ExperimentArgument = "estimate",
    out: OutOption = None,
    *,
    choices: dict[str, Any],
) -> None:
    """Estimate every capture of a folder; where the truth is present, score it too."""
    from rich.console import Console

    from toolkit.harness.estimate import evaluate_folder
    from toolkit.progress import Progress
    from toolkit.results.rows import summarize
    from toolkit.results.tables import motion_table

    folder = out or Path("runs") / "evaluate" / dataset.resolve().name
    progress = Progress(Console(stderr=True))
    rows = evaluate_folder(dataset, _single_cell(experiment, choices), folder, progress)
    console = Console()
    if rows:
        motion_table(summarize(rows)).print(console)
    console.print(f"\nWritten: {folder}", highlight=False, soft_wrap=True)


@app.command()
def report(
    runs: Annotated[list[Path], typer.Argument(help="A run folder, or the shards of one experiment.")],
    out: OutOption = None,
) -> None:
    """Print a run's table again and write its report.html anew; with --out, merge shards into one run first."""
    from toolkit.harness.merge import merge_shards
    from toolkit.harness.runs import rearranges, require_run
    from toolkit.results.report import write_completion_report, write_report

    for folder in runs:
        require_run(folder)
    if len(runs) > 1 and out is None:
        raise ToolkitError("several runs are merged into a new one: name its folder with --out")
    run = runs[0] if out is None else merge_shards(runs, out)
    _show_run(run, write_completion_report(run) if rearranges(run) else write_report(run))


@app.command()
def view(
    target: Annotated[Path, typer.Argument(help="A run folder, or a capture folder.")],
    scene: Annotated[
        int | None, typer.Argument(min=0, help="A scene of the run; its worst cases when left out.")
    ] = None,
    cell: Annotated[str | None, typer.Option(help="A cell of the run; the best when left out.")] = None,
    experiment: Annotated[str, typer.Option(help="What estimates a capture.")] = "estimate",
    plugin: Annotated[list[Path], typer.Option("--plugin", help="A plugin file that is not installed.")] = [],  # noqa: B006
    save: Annotated[Path | None, typer.Option("--save", help="The .rrd file; it is written and not opened.")] = None,
) -> None:
    """Record one scene for Rerun's viewer: frames, models, estimated motions and the truth; and open it."""
    from rich.console import Console

    from toolkit.harness.experiment import register_plugin_file
    from toolkit.harness.view import is_capture, open_viewer, view_capture, view_scene, worst_table

    for file in plugin:
        register_plugin_file(file)
    console = Console()
    if is_capture(target):
        if scene is not None or cell is not None:
            raise ToolkitError(f"'{target}' is one capture; leave SCENE and --cell out")
        choices: dict[str, Any] = {**dict.fromkeys(SLOTS, ()), "plugin": (), "set": (), "seed": None}
        file = save or Path("runs") / "view" / f"{target.resolve().name}.rrd"
        path = view_capture(target, _single_cell(experiment, choices), file)
    elif scene is None:
        console.print(worst_table(target, cell))
        console.print(f"\nNext: toolkit view {target} SCENE", highlight=False, soft_wrap=True)
        return
    else:
        path = view_scene(target, scene, cell, save)
    console.print(f"Written: {path}", highlight=False, soft_wrap=True)
    if save is None and not open_viewer(path):
        console.print(f"No display here; where there is one: rerun {path}", highlight=False, soft_wrap=True)


@app.command("list")
def list_stages(stage: Annotated[str | None, typer.Argument(help="A stage; all when left out.")] = None) -> None:
    """List the implementations of every stage; one that cannot be loaded is marked."""
    from rich.console import Console
    from rich.table import Table

    table = Table("stage", "name", "from", "what it is")
    for registry in _registries(stage):
        for entry in registry.entries():
            table.add_row(registry.stage, entry.name, entry.origin, _summary(registry, entry.name))
    Console().print(table)


@app.command()
def show(
    stage: Annotated[str, typer.Argument(help="A stage, e.g. matcher.")],
    name: Annotated[str, typer.Argument(help="An implementation, e.g. sift.")],
) -> None:
    """Show one implementation: what it does, its settings with defaults, its version, its weights."""
    from rich.console import Console
    from rich.table import Table

    from toolkit.weights.resolve import find_card

    (registry,) = _registries(stage)
    plugin = registry.get(name)
    console = Console()
    console.print(f"[bold]{stage} {name}[/bold]  version {plugin.version}  ({plugin.__module__})", highlight=False)
    console.print(inspect.getdoc(plugin) or "", markup=False, highlight=False)
    table = Table("setting", "default", "meaning")
    for key, info in plugin.Config.model_fields.items():
        default = "required" if info.is_required() else repr(info.get_default(call_default_factory=True))
        table.add_row(key, default, info.description or "")
    if plugin.Config.model_fields:
        console.print(table)
    for card in map(find_card, plugin.weights):
        terms = f"{card.licence}, non-commercial" if card.non_commercial else card.licence
        console.print(f"weights {card.name}: {terms}; {card.size_mb:.1f} MB; {card.citation}", highlight=False)


@app.command()
def check(
    stage: Annotated[str, typer.Argument(help="A stage, e.g. matcher.")],
    name: Annotated[str, typer.Argument(help="An implementation, e.g. sift.")],
    plugin: Annotated[list[Path], typer.Option("--plugin", help="A plugin file that is not installed.")] = [],  # noqa: B006
    settings: Annotated[list[str], typer.Option("--set", help="key=value of its settings.")] = [],  # noqa: B006
) -> None:
    """Check that an implementation does what its stage asks; exit code 1 where it does not."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from toolkit.harness.experiment import parse_set, register_plugin_file
    from toolkit.plugin_kit.conformance import check_plugin

    for file in plugin:
        register_plugin_file(file)
    (registry,) = _registries(stage)
    chosen = {key: values[0] for key, values in map(parse_set, settings)}
    outcomes = check_plugin(registry.get(name), chosen)
    table = Table("check", "", "time", "memory", "remark", box=None, pad_edge=False)
    for outcome in outcomes:
        mark = "[green]passed[/green]" if outcome.passed else "[red]failed[/red]"
        memory = f"+{outcome.grown_mb:.0f} MB" if outcome.grown_mb >= 1 else ""
        table.add_row(outcome.check, mark, f"{outcome.seconds:.2f} s", memory, escape(outcome.note))
    Console().print(table)
    failed = [outcome for outcome in outcomes if not outcome.passed]
    if failed:
        raise CheckFailedError(
            f"{stage} '{name}' fails {len(failed)} of {len(outcomes)} checks; {failed[0].check}: {failed[0].note}"
        )
    Console().print(f"{stage} '{name}' passes all {len(outcomes)} checks", highlight=False)


@app.command()
def doctor() -> None:
    """Say what this machine has: versions, cores, renderer, cache, and every plugin that cannot be loaded."""
    from rich.console import Console

    from toolkit.cli.doctor import diagnose

    console = Console()
    for line in diagnose():
        console.print(line, highlight=False)


@app.command()
def train(
    network: Annotated[str, typer.Argument(help="loftr or mixvpr.")],
    config: Annotated[Path | None, typer.Argument(help="A YAML file; the shipped settings when left out.")] = None,
    out: OutOption = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the folder's checkpoint.")] = False,
    train_objects: Annotated[
        Path | None,
        typer.Option(help="A folder of scans to train on, a third of which is held out; procedural if not."),
    ] = None,
    objects: Annotated[Path | None, typer.Option(help="A folder of scans to evaluate on; never trained on.")] = None,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads; all cores when left out.")] = None,
    settings: Annotated[list[str], typer.Option("--set", help="path.to.key=value of the settings.")] = [],  # noqa: B006
) -> None:
    """Train a network the toolkit ships, on views it renders itself; writes curves, checkpoints and the weights."""
    from rich.console import Console

    from toolkit.harness.experiment import parse_set
    from toolkit.progress import Progress
    from toolkit.training.run import TrainOptions, read_training
    from toolkit.training.run import train as run_training

    chosen: dict[str, Any] = {key: values[0] for key, values in map(parse_set, settings)}
    options = TrainOptions(out or Path("runs") / "train" / network, resume, train_objects, objects, threads or cores())
    path = run_training(network, read_training(network, config, chosen), options, Progress(Console(stderr=True)))
    Console().print(f"Written: {path}", highlight=False, soft_wrap=True)


@dataset_app.command("build")
def dataset_build(
    out: Annotated[Path, typer.Argument(help="Folder to write the captures to.")],
    objects: Annotated[str, typer.Option(help="'procedural', or a folder of scanned objects.")] = "procedural",
    scenes: Annotated[int, typer.Option(min=1, help="Number of scenes.")] = 150,
    seed: Annotated[int, typer.Option(min=0, help="Benchmark seed.")] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; all cores when left out.")] = None,
    settings: Annotated[list[str], typer.Option("--set", help="key=value of the benchmark.")] = [],  # noqa: B006
) -> None:
    """Build a tabletop benchmark: a folder of captures in the BOP layout."""
    from rich.console import Console

    from toolkit.data.source import build_tabletop
    from toolkit.harness.experiment import parse_set
    from toolkit.progress import Progress

    chosen: dict[str, Any] = {key: values[0] for key, values in map(parse_set, settings)}
    config = {"objects": objects, "scenes": scenes, "seed": seed, **chosen}
    build_tabletop(config, out, workers or cores(), Progress(Console(stderr=True)))
    Console().print(f"Written: {out}", highlight=False, soft_wrap=True)


@dataset_app.command("show")
def dataset_show(dataset: Annotated[Path, typer.Argument(help="A folder of captures.")]) -> None:
    """Say how a benchmark was made and what it holds, and draw its first scenes."""
    from rich.console import Console

    from toolkit.data.inspect import contact_sheet, describe

    console = Console()
    for line in describe(dataset):
        console.print(line, highlight=False)
    console.print(f"Picture: {contact_sheet(dataset)}", highlight=False, soft_wrap=True)


@plugin_app.command("new")
def plugin_new(
    stage: Annotated[str, typer.Argument(help="A stage, e.g. matcher.")],
    name: Annotated[str, typer.Argument(help="The new implementation's name.")],
    out: OutOption = None,
) -> None:
    """Write a small installable plugin that works as it stands: a module, a test, a README, a pyproject.toml."""
    from rich.console import Console

    from toolkit.plugin_kit.scaffold import new_plugin

    folder = new_plugin(stage, name, out)
    console = Console()
    console.print(f"Written: {folder}", highlight=False, soft_wrap=True)
    file = folder / f"toolkit_{name}.py"
    console.print(f"Next: toolkit check {stage} {name} --plugin {file}", highlight=False, soft_wrap=True)


@weights_app.command("list")
def weights_list() -> None:
    """List every checkpoint: its licence, its size, and whether this machine has it."""
    from rich.console import Console
    from rich.table import Table

    from toolkit.weights.cards import CARDS
    from toolkit.weights.resolve import find_weights

    table = Table("name", "what it is", "licence", "MB", "here")
    for name, card in sorted(CARDS.items()):
        licence = f"{card.licence} [red](non-commercial)[/red]" if card.non_commercial else card.licence
        table.add_row(name, card.architecture, licence, f"{card.size_mb:.1f}", "yes" if find_weights(card) else "no")
    Console().print(table)


@weights_app.command("pull")
def weights_pull(names: Annotated[list[str], typer.Argument(help="Names from `toolkit weights list`.")]) -> None:
    """Fetch checkpoints that this machine lacks, check their digests, and say where they lie."""
    from rich.console import Console

    from toolkit.weights.resolve import find_card, resolve_weights

    for name in names:
        find_card(name)
    for name in names:
        Console().print(f"{name}: {resolve_weights(name)}", highlight=False, soft_wrap=True)


@weights_app.command("where")
def weights_where(name: Annotated[str, typer.Argument(help="A name from `toolkit weights list`.")]) -> None:
    """Say where a checkpoint lies, or where it is looked for and what it is fetched from."""
    from rich.console import Console

    from toolkit.weights.resolve import find_card, find_weights, weight_folders

    console, card = Console(), find_card(name)
    found = find_weights(card)
    if found is None:
        folders = " or ".join(f"'{folder}'" for folder in weight_folders())
        lines = [f"not on this machine; looked for {card.file} in {folders}", *card.sources]
    else:
        lines = [str(found)]
    for line in [*lines, card.citation]:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _show_run(run: Path, page: Path) -> None:
    """Print a run's tables, whatever its rows are, and say where its page lies."""
    from rich.console import Console

    from toolkit.harness.runs import ROWS, rearranges
    from toolkit.results.comparisons import print_results
    from toolkit.results.completion import MoveRow, summarize_completion
    from toolkit.results.rows import read_rows, read_rows_as
    from toolkit.results.tables import completion_table

    console = Console()
    if rearranges(run):
        completion_table(summarize_completion(read_rows_as(MoveRow, run / ROWS))).print(console)
    else:
        print_results(read_rows(run / ROWS), console)
    console.print(f"\nReport: {page}", highlight=False, soft_wrap=True)


def _single_cell(experiment: str, choices: dict[str, Any]) -> Cell:
    from toolkit.harness.experiment import expand

    cells = expand(read_experiment(experiment, choices))
    if len(cells) > 1:
        raise ToolkitError(
            f"this command runs one setting, but {len(cells)} are asked for; use `toolkit ablate` to sweep"
        )
    return cells[0]


def _registries(stage: str | None) -> list[Registry[Any]]:
    from toolkit.errors import suggest
    from toolkit.stages import REGISTRIES

    if stage is None:
        return list(REGISTRIES.values())
    if stage not in REGISTRIES:
        raise ToolkitError(f"unknown stage '{stage}'{suggest(stage, list(REGISTRIES))}")
    return [REGISTRIES[stage]]


def _summary(registry: Registry[Any], name: str) -> str:
    try:
        return (inspect.getdoc(registry.get(name)) or "").partition("\n")[0]
    except ToolkitError as error:
        return f"[red]cannot be used: {error}[/red]"


class CheckFailedError(Exception):
    """A plugin fails a check."""


class _Stopped(BaseException):
    """Ctrl-C. Not a KeyboardInterrupt, which Typer would answer in its own words."""


def _stop(*_: object) -> None:
    raise _Stopped


def main() -> None:
    """Entry point: a user's mistake is answered in one or two lines and exit code 2, never with a traceback."""
    signal.signal(signal.SIGINT, _stop)
    try:
        app()
    except ToolkitError as error:
        sys.stderr.write(f"error: {error}\n")
        sys.exit(2)
    except CheckFailedError as error:
        sys.stderr.write(f"error: {error}\n")
        sys.exit(1)
    except _Stopped:
        sys.stderr.write("stopped; finished rows are kept, and --resume goes on with them\n")
        sys.exit(130)
