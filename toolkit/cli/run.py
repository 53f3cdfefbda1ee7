"""`toolkit ablate` and `toolkit rearrange`: experiments."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

import typer

from toolkit.cli.completion import experiment_names
from toolkit.cli.console import bars
from toolkit.cli.options import (
    ExperimentArgument,
    read_experiment,
    run_options,
    with_experiment_options,
    with_run_options,
)
from toolkit.cli.results import show_run
from toolkit.slots import REARRANGE_SLOTS, SLOTS

app = typer.Typer()


@app.command()
@partial(with_experiment_options, sweeps=True)
@with_run_options
def ablate(
    experiment: Annotated[
        str | None,
        typer.Argument(
            autocompletion=experiment_names,
            help="A shipped experiment's name, or a YAML file; else paper_quick, or quick with your settings.",
        ),
    ] = None,
    attribute: Annotated[bool, typer.Option("--attribute", help="What each stage costs: truth in its place.")] = False,
    *,
    choices: dict[str, Any],
    run: dict[str, Any],
) -> None:
    """Run an experiment's cells on the same scenes, print the table and write rows and a report."""
    from toolkit.harness.ablate import Ablation
    from toolkit.harness.attribution import attribution
    from toolkit.harness.drive import drive

    changes = attribute or any(choices[name] for name in (*SLOTS, "set"))
    options = run_options(choices, **run)
    loaded = read_experiment(experiment or ("quick" if changes else "paper_quick"), choices)
    show_run(drive(Ablation(), attribution(loaded) if attribute else loaded, options, bars()))


@app.command()
@partial(with_experiment_options, slots=(*SLOTS, *REARRANGE_SLOTS), sweeps=True)
@with_run_options
def rearrange(
    experiment: ExperimentArgument = "rearrange",
    film: Annotated[bool, typer.Option("--film", help="Film the first scene (film.mp4, film.rrd).")] = False,
    *,
    choices: dict[str, Any],
    run: dict[str, Any],
) -> None:
    """Perceive, plan and move in simulation until every object stands at its goal; print how often that works."""
    from toolkit.harness.drive import drive
    from toolkit.harness.rearrange import Rearrangement

    options = run_options(choices, **run)
    loaded = read_experiment(experiment, choices, rearranges=True)
    show_run(drive(Rearrangement(film), loaded, options, bars()))
