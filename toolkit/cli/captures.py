"""`toolkit estimate`, `toolkit evaluate` and `toolkit capture`: captures from disk."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from toolkit.cli.console import bars, say
from toolkit.cli.options import ExperimentArgument, OutOption, read_cell, with_experiment_options

app = typer.Typer()
capture_app = typer.Typer(help="Look at a capture folder.", no_args_is_help=True)
app.add_typer(capture_app, name="capture")


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
    progress = bars()
    folder = out or Path("runs") / "estimate" / capture.resolve().name
    with progress.waiting("Loading"):
        from toolkit.data.bop import masked_scenes
        from toolkit.harness.estimate import estimate_folder
        from toolkit.results.answer import motions, to_look_at, why_nothing

        if masks is not None:
            slots = {"current": "segmenter", "goal": "goal_segmenter"}
            scenes = masked_scenes(masks)
            choices |= {slots[scene]: ["masks"] for scene in scenes}
            # An explainer would draw the goal's masks anew.
            choices |= {"explainer": ["none"]} if "goal" in scenes else {}
        answer = estimate_folder(capture, read_cell(experiment, choices), folder, progress, masks)
    if answer.estimates:
        say(motions(answer.estimates, answer.points()))
    doubts = list(to_look_at(answer.estimates, answer.missing(), answer.findings))
    say(*(["Look at:", *(f"  {doubt}" for doubt in doubts), ""] if doubts else []))
    say(f"Pictures: {folder / 'overlay.png'}", f"Written: {folder / 'poses.json'}")
    if all(estimate.T_goal_current is None for estimate in answer.estimates):
        sys.stderr.write(why_nothing(answer.estimates, len(answer.database)) + "\n")
        raise typer.Exit(1)


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


@capture_app.command("check")
def check(
    capture: Annotated[Path, typer.Argument(help="A capture folder (BOP scene layout).")],
    masks: Annotated[Path | None, typer.Option(help="Your own masks, in current/ and goal/ of this folder.")] = None,
    out: OutOption = None,
) -> None:
    """Say what is wrong with a capture: poses, units, axes, cam_K, depth, light, and whether the goal fits."""
    progress = bars()
    with progress.waiting("Checking"):
        from toolkit.data.bop import load_capture
        from toolkit.harness.runs import writable
        from toolkit.perception.checks.capture import check_capture, refuse
        from toolkit.pictures.findings import illustrated

        loaded = load_capture(capture, masks)
        folder = out or Path("runs") / "check" / capture.resolve().name
        with writable(f"'{folder}'"):
            findings = illustrated(folder, loaded.current, loaded.goal, check_capture(loaded))
    say(*loaded.notes)
    refuse(findings)
    say(*(f"{finding.severity}: {finding.sentence}" for finding in findings))
    if not findings:
        count = len(loaded.current)
        say(f"nothing is wrong with {count} current frame{'s' if count > 1 else ''} and the goal that can be measured")
