"""`toolkit estimate` and `toolkit evaluate`: captures from disk."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from toolkit.cli.console import bars, say
from toolkit.cli.options import ExperimentArgument, OutOption, read_cell, with_experiment_options

app = typer.Typer()


@app.command()
@with_experiment_options
def estimate(
    capture: Annotated[Path, typer.Argument(help="A capture folder (BOP scene layout).")],
    experiment: ExperimentArgument = "estimate",
    out: OutOption = None,
    masks: Annotated[
        Path | None, typer.Option(help="Your own masks, in current/ and goal/ of this folder: no segmenter is asked.")
    ] = None,
    *,
    choices: dict[str, Any],
) -> None:
    """Estimate the motion of every object of one capture: poses.json, and pictures to judge them by."""
    from toolkit.data.bop import masked_scenes
    from toolkit.harness.estimate import estimate_folder, poses_table

    folder = out or Path("runs") / "estimate" / capture.resolve().name
    if masks is not None:
        slots = {"current": "segmenter", "goal": "goal_segmenter"}
        choices |= {slots[scene]: ["masks"] for scene in masked_scenes(masks)}
    estimates = estimate_folder(capture, read_cell(experiment, choices), folder, bars(), masks)
    say(poses_table(estimates), f"\nWritten: {folder / 'poses.json'}")


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
    from toolkit.results.rows import summarize
    from toolkit.results.tables import motion_table

    folder = out or Path("runs") / "evaluate" / dataset.resolve().name
    rows = evaluate_folder(dataset, read_cell(experiment, choices), folder, bars())
    if rows:
        motion_table(summarize(rows)).print(Console())
    say(f"\nWritten: {folder}")
