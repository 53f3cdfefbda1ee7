"""`toolkit train`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from toolkit.cli.console import bars, say
from toolkit.cli.options import OutOption, SettingsOption, single_values
from toolkit.parallel import cores

app = typer.Typer()


@app.command()
def train(
    network: Annotated[str, typer.Argument(help="loftr or mixvpr.")],
    config: Annotated[Path | None, typer.Argument(help="A YAML file; the shipped settings when left out.")] = None,
    out: OutOption = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the folder's checkpoint.")] = False,
    train_objects: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="A folder of scans to train on, a third of which is held out; procedural objects when left out.",
        ),
    ] = None,
    objects: Annotated[
        Path | None, typer.Option(metavar="DIR", help="A folder of scans to evaluate on; never trained on.")
    ] = None,
    threads: Annotated[int | None, typer.Option(min=1, metavar="N", help="Threads; all cores when left out.")] = None,
    device: Annotated[str, typer.Option(help="What torch trains on, such as cuda.")] = "cpu",
    workers: Annotated[int, typer.Option(min=0, metavar="N", help="Processes that draw samples ahead.")] = 0,
    settings: SettingsOption = [],  # noqa: B006
) -> None:
    """Train a network the toolkit ships, on views it renders itself; writes curves, checkpoints and the weights."""
    from toolkit.training.run import TrainOptions, read_training
    from toolkit.training.run import train as run_training

    folder = out or Path("runs") / "train" / network
    options = TrainOptions(folder, resume, train_objects, objects, threads or cores(), device, workers)
    path = run_training(network, read_training(network, config, single_values(settings)), options, bars())
    say(f"Written: {path}")
