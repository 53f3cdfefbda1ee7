"""Options that several commands share, each written down once; a command receives them together."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from toolkit.cli.completion import experiment_names, implementation_names, implementations_of, stage_names
from toolkit.errors import ToolkitError
from toolkit.parallel import cores
from toolkit.slots import REARRANGE_SLOTS, SLOTS

if TYPE_CHECKING:
    from toolkit.harness.experiment import Cell, Experiment
    from toolkit.harness.runs import RunOptions

ExperimentArgument = Annotated[
    str, typer.Argument(autocompletion=experiment_names, help="A shipped experiment's name, or a YAML file.")
]
StageArgument = Annotated[str, typer.Argument(autocompletion=stage_names, help="A stage, e.g. matcher.")]
ImplementationArgument = Annotated[
    str, typer.Argument(autocompletion=implementation_names, help="An implementation, e.g. sift.")
]
OutOption = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder to write to.")]
PluginOption = Annotated[
    list[Path], typer.Option("--plugin", metavar="FILE", help="A plugin file that is not installed.")
]
SettingsOption = Annotated[
    list[str], typer.Option("--set", metavar="PATH=VALUE", help="path.to.key=value of the settings.")
]

_STAGES = "Stages, by name (toolkit list)"


def with_experiment_options(
    command: Callable[..., None], slots: Iterable[str] = SLOTS, *, sweeps: bool = False
) -> Callable[..., None]:
    """Add one option per slot, and --set, --plugin and --seed, to a command that takes an experiment.

    The command receives them as `choices`, which `read_experiment` understands.

    Args:
        command: which.
        slots: the stages that it lets one choose.
        sweeps: it runs all cells that several values make, as the help then says.
    """
    panel = f"{_STAGES}; one that is given twice is swept" if sweeps else _STAGES
    added = [
        _option(
            slot,
            [],
            Annotated[
                list[str],
                typer.Option(
                    f"--{slot.replace('_', '-')}",
                    metavar="NAME",
                    autocompletion=implementations_of(slot),
                    rich_help_panel=panel,
                ),
            ],
        )
        for slot in slots
    ]
    setting = (
        typer.Option("--set", metavar="PATH=V1,V2", help="A setting (toolkit show dataset); several values sweep.")
        if sweeps
        else typer.Option("--set", metavar="PATH=VALUE", help="A setting (toolkit show pipeline).")
    )
    added += [
        _option("set", [], Annotated[list[str], setting]),
        _option("plugin", [], PluginOption),
        _option(
            "seed", None, Annotated[int | None, typer.Option("--seed", metavar="N", help="Seed of scenes and stages.")]
        ),
    ]
    return _with_options(command, added, "choices")


def with_run_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of `run_options` to a command that runs an experiment; it receives them as `run`."""
    # RunOptions is not imported before a command needs it; of the signature only the parameters matter.
    parameters = inspect.signature(run_options, eval_str=True, locals={"RunOptions": object}).parameters
    return _with_options(command, [p for name, p in parameters.items() if name != "choices"], "run")


def run_options(
    choices: dict[str, Any],
    *,
    objects: Annotated[
        str | None, typer.Option(metavar="DIR", help="A folder of scanned objects; or 'procedural'.")
    ] = None,
    scenes: Annotated[int | None, typer.Option(min=1, metavar="N", help="Number of scenes.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, metavar="N", help="Processes; else one per core.")] = None,
    backend: Annotated[str, typer.Option(metavar="NAME", help="What starts workers: loky, dask or ray.")] = "loky",
    address: Annotated[
        str | None, typer.Option(metavar="URL", help="A dask or ray cluster; else this machine.")
    ] = None,
    shard: Annotated[str, typer.Option(metavar="I/N", help="Only the I-th of N parts of the scenes.")] = "1/1",
    out: OutOption = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the newest such run.")] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Start again where a run lies.")] = False,
    no_cache: Annotated[bool, typer.Option("--no-cache", help="Neither keep nor reuse stage outputs.")] = False,
    log: Annotated[list[str], typer.Option(metavar="NAME", help="A hook that follows: tensorboard or yours.")] = [],  # noqa: B006
) -> RunOptions:
    """How to run; the options of the dataset go into `choices`, as if --set had named them.

    Raises:
        ToolkitError: options that do not go together.
    """
    from toolkit.harness.runs import RunOptions, Shard

    if address is not None and workers is not None:
        raise ToolkitError("--workers counts processes on this machine; a cluster at an --address has its own")
    for key, value in (("objects", objects), ("scenes", scenes)):
        if value is not None:
            choices["set"] = [*choices["set"], f"dataset.{key}={value}"]
    return RunOptions(
        out=out,
        workers=workers or cores(),
        backend=backend,
        address=address,
        shard=Shard.parse(shard),
        resume=resume,
        fresh=fresh,
        use_cache=not no_cache,
        plugin_files=tuple(choices["plugin"]),
        log=tuple(dict.fromkeys(log)),
    )


def read_experiment(name: str, choices: Mapping[str, Any], *, rearranges: bool = False) -> Experiment:
    """The experiment with the command line's choices applied."""
    from toolkit.harness.experiment import load_experiment
    from toolkit.settings import parse_set

    register_plugin_files(choices.get("plugin", ()))
    for slot in SLOTS | REARRANGE_SLOTS:
        _require_one_name_each(slot, choices.get(slot, ()))
    overrides: dict[str, list[Any]] = {f"pipeline.{slot}": choices[slot] for slot in SLOTS if choices.get(slot)}
    overrides |= {f"rearrange.{slot}": choices[slot] for slot in REARRANGE_SLOTS if choices.get(slot)}
    overrides |= dict(map(parse_set, choices.get("set", ())))
    if choices.get("seed") is not None:
        overrides["seed"] = [choices["seed"]]
    return load_experiment(name, overrides, rearranges=rearranges)


def _require_one_name_each(slot: str, names: Iterable[str]) -> None:
    """Refuse `--matcher a,b`, since --set takes commas and these options do not; say how it is done."""
    option = f"--{slot.replace('_', '-')}"
    for name in names:
        if "," in name:
            each = " ".join(f"{option} {part.strip()}" for part in name.split(",") if part.strip())
            raise ToolkitError(f"{option} takes one name, got '{name}'; give it once for each: {each}")


def read_cell(experiment: str, choices: Mapping[str, Any], *, rearranges: bool = False) -> Cell:
    """The one cell of an experiment with the command line's choices applied.

    Raises:
        ToolkitError: they make several.
    """
    from toolkit.harness.experiment import only_cell

    return only_cell(read_experiment(experiment, choices, rearranges=rearranges))


def register_plugin_files(files: Iterable[Path]) -> None:
    """Load what --plugin names.

    Raises:
        ToolkitError: a file is absent, does not import, or holds no plugin.
    """
    from toolkit.harness.experiment import register_plugin_file

    for file in files:
        register_plugin_file(file)


def single_values(settings: Iterable[str]) -> dict[str, Any]:
    """What --set gives to a command that does not sweep: a value by path.

    Raises:
        ToolkitError: an option is not path.to.key=value, or names several values.
    """
    from toolkit.settings import parse_set

    chosen: dict[str, Any] = {}
    for path, values in map(parse_set, settings):
        if len(values) > 1:
            raise ToolkitError(f"--set {path} takes one value here, got {len(values)}; only experiments sweep")
        chosen[path] = values[0]
    return chosen


def _option(name: str, default: Any, annotation: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _with_options(command: Callable[..., None], added: Iterable[inspect.Parameter], into: str) -> Callable[..., None]:
    """A command that takes options besides its own and receives their values together, as its parameter `into`."""
    added = list(added)
    own = [p for name, p in inspect.signature(command, eval_str=True).parameters.items() if name != into]

    def wrapper(**arguments: Any) -> None:
        values = {p.name: arguments.pop(p.name) for p in added}
        command(**arguments, **{into: values})

    parameters = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in (*own, *added)]
    wrapper.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportFunctionMemberAccess]
    wrapper.__annotations__ = {p.name: p.annotation for p in parameters}
    wrapper.__name__, wrapper.__doc__ = command.__name__, command.__doc__
    return wrapper
