"""Options that several commands share, each written down once; a command receives them together."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from toolkit.errors import ToolkitError
from toolkit.parallel import cores
from toolkit.slots import REARRANGE_SLOTS, SLOTS

if TYPE_CHECKING:
    from toolkit.harness.experiment import Experiment
    from toolkit.harness.runs import RunOptions

ExperimentArgument = Annotated[str, typer.Argument(help="A shipped experiment's name, or a YAML file.")]
OutOption = Annotated[Path | None, typer.Option("--out", help="Folder to write to.")]


def with_experiment_options(command: Callable[..., None], slots: Iterable[str] = SLOTS) -> Callable[..., None]:
    """Add one option a slot, and --set, --plugin and --seed, to a command that takes an experiment.

    The command receives them as `choices`, which `read_experiment` understands.
    """
    helps = {
        slot: f"The {slot.replace('_', ' ')}; given twice, it sweeps instead of the experiment's own sweep."
        for slot in slots
    }
    lists = [_option(slot, list[str], [], f"--{slot.replace('_', '-')}", text) for slot, text in helps.items()]
    own = [
        _option("set", list[str], [], "--set", "path.to.key=v1,v2; several values sweep."),
        _option("plugin", list[Path], [], "--plugin", "A plugin file that is not installed."),
        _option("seed", int | None, None, "--seed", "Seed of scenes and stages."),
    ]
    return _with_options(command, [*lists, *own], "choices")


def with_run_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of `run_options` to a command that runs an experiment; it receives them as `run`."""
    # RunOptions is not imported before a command needs it; of the signature only the parameters matter.
    parameters = inspect.signature(run_options, eval_str=True, locals={"RunOptions": object}).parameters
    return _with_options(command, [p for name, p in parameters.items() if name != "choices"], "run")


def run_options(
    choices: dict[str, Any],
    *,
    objects: Annotated[str | None, typer.Option(help="'procedural', or a folder of scanned objects.")] = None,
    scenes: Annotated[int | None, typer.Option(min=1, help="Number of scenes.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; all cores when left out.")] = None,
    backend: Annotated[str, typer.Option(help="What the processes belong to: loky, dask or ray.")] = "loky",
    address: Annotated[str | None, typer.Option(help="A dask or ray cluster to use; else this machine.")] = None,
    shard: Annotated[str, typer.Option(help="I/N: only the I-th of N parts of the scenes.")] = "1/1",
    out: OutOption = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the newest run of these settings.")] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Start again in a folder that holds a run.")] = False,
    cache: Annotated[bool, typer.Option("--cache/--no-cache", help="Keep and reuse stage outputs.")] = True,
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
        use_cache=cache,
        plugin_files=tuple(choices["plugin"]),
    )


def read_experiment(name: str, choices: Mapping[str, Any], *, rearranges: bool = False) -> Experiment:
    """The experiment with the command line's choices applied."""
    from toolkit.harness.experiment import load_experiment, parse_set, register_plugin_file

    for file in choices["plugin"]:
        register_plugin_file(file)
    overrides: dict[str, list[Any]] = {f"pipeline.{slot}": choices[slot] for slot in SLOTS if choices[slot]}
    overrides |= {f"rearrange.{slot}": choices[slot] for slot in REARRANGE_SLOTS if choices.get(slot)}
    overrides |= dict(parse_set(option) for option in choices["set"])
    if choices["seed"] is not None:
        overrides["seed"] = [choices["seed"]]
    return load_experiment(name, overrides, rearranges=rearranges)


def _option(name: str, kind: Any, default: Any, flag: str, text: str) -> inspect.Parameter:
    annotation = Annotated[kind, typer.Option(flag, help=text)]
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
