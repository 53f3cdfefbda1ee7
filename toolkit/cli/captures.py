"""`toolkit estimate`, `toolkit evaluate`, `toolkit plan` and `toolkit capture`: captures from disk."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from toolkit.cli.completion import import_kinds
from toolkit.cli.console import bars, say
from toolkit.cli.options import (
    ExperimentArgument,
    OutOption,
    SettingsOption,
    read_cell,
    single_values,
    with_experiment_options,
)
from toolkit.slots import SLOTS

MasksOption = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Your own masks, in current/ and goal/ of this folder: no segmenter is asked."),
]

app = typer.Typer()
capture_app = typer.Typer(help="Check a capture folder, make one of a recording, or take one.", no_args_is_help=True)
app.add_typer(capture_app, name="capture")


@app.command()
@with_experiment_options
def estimate(
    capture: Annotated[Path, typer.Argument(help="A capture folder (BOP scene layout).")],
    experiment: ExperimentArgument = "estimate",
    out: OutOption = None,
    masks: MasksOption = None,
    *,
    choices: dict[str, Any],
) -> None:
    """Estimate the motion of every object of one capture: poses.json, and pictures to judge them by."""
    progress = bars()
    folder = out or Path("runs") / "estimate" / capture.resolve().name
    with progress.waiting("Loading"):
        from toolkit.harness.estimate import estimate_folder
        from toolkit.results.answer import motions, to_look_at, why_nothing

        choices |= _own_masks(masks)
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


@app.command()
@partial(with_experiment_options, slots=(*SLOTS, "planner"))
def plan(
    capture: Annotated[Path, typer.Argument(help="A capture folder (BOP scene layout).")],
    experiment: ExperimentArgument = "estimate",
    out: OutOption = None,
    base: Annotated[
        str | None,
        typer.Option(
            metavar="POSE",
            help="Where the robot stands in the capture's world: 'x y z qx qy qz qw', metres; "
            "else the world is the robot's base frame.",
        ),
    ] = None,
    sure: Annotated[
        float,
        typer.Option(
            min=0, max=1, metavar="SHARE", help="Objects whose confidence is below this are left where they are."
        ),
    ] = 0.5,
    film: Annotated[bool, typer.Option(help="Film the plan (plan.mp4, plan.rrd).")] = True,
    masks: MasksOption = None,
    *,
    choices: dict[str, Any],
) -> None:
    """Plan what an arm does to set one capture right: plan.json with timed trajectories, and a film. Nothing moves."""
    progress = bars()
    folder = out or Path("runs") / "plan" / capture.resolve().name
    with progress.waiting("Loading"):
        import numpy as np

        from toolkit.data.importing.settings import told_pose
        from toolkit.harness.plan import PlanRequest, plan_folder

        choices |= _own_masks(masks)
        choices["set"] = ["rearrange.executor=arm", *choices["set"]]
        request = PlanRequest(np.eye(4) if base is None else told_pose(base, "--base"), sure, film, masks)
        cell = read_cell(experiment, choices, rearranges=True)
        made = plan_folder(capture, cell, folder, request, progress)
    say(*made.in_words(), *([f"Film: {folder / 'plan.mp4'}"] if film and made.moves else []))
    say(f"Written: {folder / 'plan.json'}")
    if not made.moves and made.not_planned:
        sys.stderr.write("no object can be moved; the reasons stand above\n")
        raise typer.Exit(1)


def _own_masks(masks: Path | None) -> dict[str, list[str]]:
    """The choices that a folder of a user's own masks makes."""
    from toolkit.data.bop import masked_scenes

    if masks is None:
        return {}
    slots = {"current": "segmenter", "goal": "goal_segmenter"}
    scenes = masked_scenes(masks)
    # An explainer would draw the goal's masks anew.
    return {slots[scene]: ["masks"] for scene in scenes} | ({"explainer": ["none"]} if "goal" in scenes else {})


@capture_app.command("check")
def check(
    capture: Annotated[Path, typer.Argument(help="A capture folder (BOP scene layout).")],
    masks: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Your own masks, in current/ and goal/ of this folder.")
    ] = None,
    out: OutOption = None,
) -> None:
    """Say what is wrong with a capture: poses, units, axes, cam_K, depth, light, and whether the goal fits."""
    progress = bars()
    with progress.waiting("Checking"):
        from toolkit.data.bop import load_capture
        from toolkit.files import writing
        from toolkit.perception.checks.capture import check_capture, refuse
        from toolkit.pictures.findings import illustrated

        loaded = load_capture(capture, masks)
        folder = out or Path("runs") / "check" / capture.resolve().name
        with writing(f"'{folder}'"):
            findings = illustrated(folder, loaded.current, loaded.goal, check_capture(loaded))
    say(*loaded.notes)
    refuse(findings)
    say(*(f"{finding.severity}: {finding.sentence}" for finding in findings))
    if not findings:
        count = len(loaded.current)
        say(f"nothing is wrong with {count} current frame{'s' if count > 1 else ''} and the goal that can be measured")


@capture_app.command("import")
def import_(
    kind: Annotated[str, typer.Argument(autocompletion=import_kinds, help="What SOURCE is: bop, tum, ros, ...")],
    source: Annotated[Path, typer.Argument(help="The recording of the current scene: a folder or a file.")],
    out: Annotated[Path, typer.Argument(help="The capture folder to write.")],
    goal: Annotated[
        str,
        typer.Option(metavar="IMAGE", help="The goal image: its name or number in the recording, or a picture file."),
    ],
    goal_source: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Another recording in the same world, which holds the goal image."),
    ] = None,
    goal_camera: Annotated[
        str | None,
        typer.Option(metavar="IMAGE", help="For a picture file: the image that was taken from the same place."),
    ] = None,
    frames: Annotated[
        str | None, typer.Option(metavar="FRAMES", help="Current frames: names, numbers and ranges, as 3,7 or 100:300.")
    ] = None,
    every: Annotated[int | None, typer.Option(min=1, metavar="N", help="Take every N-th of them.")] = None,
    settings: SettingsOption = [],  # noqa: B006
) -> None:
    """Make a capture of a recording; of its images, 8 are taken where neither --frames nor --every says which."""
    progress = bars()
    with progress.waiting("Reading"):
        from toolkit.data.importing import IMPORTERS
        from toolkit.data.importing.choosing import Frames
        from toolkit.data.importing.writing import Goal, import_capture

        importer = IMPORTERS.create(kind, single_values(settings))
        recording, other = (None if path is None else importer.read(path) for path in (source, goal_source))
        assert recording is not None
        notes = import_capture(recording, out, Goal(goal, other, goal_camera), Frames(frames, every))
    say(*notes, f"Written: {out}", f"Next: toolkit capture check {out}")


@capture_app.command("record")
def record(
    out: Annotated[Path, typer.Argument(help="The capture folder to write.")],
    hand_eye: Annotated[
        str,
        typer.Option(
            metavar="POSE", help="The colour camera on the body whose poses are told: 'x y z qx qy qz qw', metres."
        ),
    ],
    size: Annotated[
        tuple[int, int], typer.Option(metavar="W H", help="Width and height of colour and depth, pixels.")
    ] = (640, 480),
    rate: Annotated[int, typer.Option(min=1, metavar="N", help="Frames per second.")] = 30,
) -> None:
    """Take a capture with a RealSense camera: a picture for every pose on standard input, `goal` before the goal's."""
    from toolkit.data.importing.recorder import record_capture
    from toolkit.data.importing.settings import told_pose
    from toolkit.data.importing.streams import Stream

    T_body_camera = told_pose(hand_eye, "--hand-eye")
    with Stream.of_camera(*size, rate) as stream:
        if sys.stdin.isatty():
            say("A pose and Enter for every picture (x y z qx qy qz qw), 'goal' before the goal's; Ctrl-D at the end:")
        count = record_capture(stream, sys.stdin, T_body_camera, out)
    say(f"Written: {out}, with {count} current frames and the goal", f"Next: toolkit capture check {out}")
