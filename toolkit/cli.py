"""The command line. Nothing heavy is imported before a command needs it."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from toolkit.errors import ToolkitError
from toolkit.slots import SLOTS

if TYPE_CHECKING:
    from toolkit.experiment import Experiment

app = typer.Typer(
    name="toolkit",
    help="Image-goal object rearrangement by multi-view fusion: every stage swappable, every swap measured.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
dataset_app = typer.Typer(help="Make or inspect a benchmark.", no_args_is_help=True)
weights_app = typer.Typer(help="Checkpoints: what there is, where it lies, fetching it.", no_args_is_help=True)
app.add_typer(dataset_app, name="dataset")
app.add_typer(weights_app, name="weights")

ExperimentArgument = Annotated[str, typer.Argument(help="A shipped experiment's name, or a YAML file.")]
OutOption = Annotated[Path | None, typer.Option("--out", help="Folder to write to.")]


def with_experiment_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add one option a pipeline slot, and --set, --plugin and --seed, to a command that takes an experiment.

    The command receives them together, as `choices`.
    """
    own = [p for name, p in inspect.signature(command).parameters.items() if name != "choices"]
    options = {slot: list[str] for slot in SLOTS} | {"set": list[str], "plugin": list[Path]}
    helps = {slot: f"The {slot.replace('_', ' ')}; given twice, it sweeps." for slot in SLOTS} | {
        "set": "path.to.key=v1,v2; several values sweep.",
        "plugin": "A plugin file that is not installed.",
    }
    added = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=[],
            annotation=Annotated[kind, typer.Option(f"--{name.replace('_', '-')}", help=helps[name])],
        )
        for name, kind in options.items()
    ]
    seed = inspect.Parameter(
        "seed",
        inspect.Parameter.KEYWORD_ONLY,
        default=None,
        annotation=Annotated[int | None, typer.Option("--seed", help="Seed of scenes and stages.")],
    )

    def wrapper(**arguments: Any) -> None:
        names = [*options, "seed"]
        choices = {name: arguments.pop(name) for name in names}
        command(**arguments, choices=choices)

    parameters = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own] + [*added, seed]
    wrapper.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportFunctionMemberAccess]
    wrapper.__annotations__ = {p.name: p.annotation for p in parameters}
    wrapper.__name__, wrapper.__doc__ = command.__name__, command.__doc__
    return wrapper


def read_experiment(name: str, choices: dict[str, Any], dataset: dict[str, Any] | None = None) -> Experiment:
    """The experiment with the command line's choices applied; `dataset` replaces its dataset part."""
    from toolkit.experiment import load_experiment, parse_set, register_plugin_file

    for file in choices["plugin"]:
        register_plugin_file(file)
    overrides: dict[str, list[Any]] = {f"pipeline.{slot}": choices[slot] for slot in SLOTS if choices[slot]}
    overrides |= dict(parse_set(option) for option in choices["set"])
    if choices["seed"] is not None:
        overrides["seed"] = [choices["seed"]]
    return load_experiment(name, overrides, dataset)


@app.command()
@with_experiment_options
def ablate(
    experiment: ExperimentArgument = "quick",
    objects: Annotated[str | None, typer.Option(help="'procedural', or a folder of scanned objects.")] = None,
    scenes: Annotated[int | None, typer.Option(min=1, help="Number of scenes.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; all cores when left out.")] = None,
    backend: Annotated[str, typer.Option(help="joblib backend.")] = "loky",
    out: OutOption = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the newest run of these settings.")] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Start again in a folder that holds a run.")] = False,
    cache: Annotated[bool, typer.Option("--cache/--no-cache", help="Keep and reuse stage outputs.")] = True,
    *,
    choices: dict[str, Any],
) -> None:
    """Run an experiment's cells on the same scenes, print the table and write rows and a report."""
    from rich.console import Console

    from toolkit.ablate import RunOptions, run_experiment
    from toolkit.progress import Progress
    from toolkit.results import read_rows, summarize
    from toolkit.runs import ROWS

    for key, value in (("objects", objects), ("scenes", scenes)):
        if value is not None:
            choices["set"] = [*choices["set"], f"dataset.{key}={value}"]
    console = Console()
    options = RunOptions(
        out=out,
        workers=workers or _cores(),
        backend=backend,
        resume=resume,
        fresh=fresh,
        use_cache=cache,
        plugin_files=tuple(choices["plugin"]),
    )
    run = run_experiment(read_experiment(experiment, choices), options, Progress(Console(stderr=True)))
    print_table(summarize(read_rows(run / ROWS)), console)
    console.print(f"\nReport: [link]{run / 'report.html'}[/link]", highlight=False)


@app.command()
@with_experiment_options
def estimate(
    capture: Annotated[Path, typer.Argument(help="A capture folder (BOP scene layout).")],
    experiment: ExperimentArgument = "estimate",
    out: OutOption = None,
    *,
    choices: dict[str, Any],
) -> None:
    """Estimate the motion of every object of one capture: poses.json and pictures."""
    from rich.console import Console

    from toolkit.estimate import estimate_folder

    cell = _single_cell(experiment, choices)
    written = estimate_folder(capture, cell, out or Path("runs") / "estimate" / capture.resolve().name)
    Console().print(written.table())
    Console().print(f"\nWritten: {written.poses}", highlight=False)
