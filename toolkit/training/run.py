"""`toolkit train`: settings from YAML, a task, the loop, and the file it leaves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import torch
import yaml

from toolkit.data.objects import load_object_set
from toolkit.errors import ToolkitError, suggest
from toolkit.files import may_write, write_text
from toolkit.paths import cache_root
from toolkit.progress import Progress
from toolkit.registry import validated
from toolkit.settings import assign, read_settings, shipped_settings
from toolkit.training.config import LoftrTraining, MixvprTraining
from toolkit.training.export import export
from toolkit.training.loftr import LoftrTask
from toolkit.training.loop import Trainer
from toolkit.training.mixvpr import MixvprTask
from toolkit.weights.resolve import file_digest, resolve_weights

_STARTS = {"xfeat": "xfeat", "tabletop": "loftr-tabletop"}
"""Names of the weight cards that a LoFTR may start from."""

NETWORKS = {"loftr": LoftrTraining, "mixvpr": MixvprTraining}


@dataclass(frozen=True)
class TrainOptions:
    """What the command line adds to the settings.

    Attributes:
        out: folder for checkpoint, curves and the exported file.
        resume: go on from the folder's checkpoint.
        objects: a folder of scans to train on in place of procedural objects; a third of them is held out.
        scans: a folder of scans to evaluate on besides the held-out objects; never trained on.
        threads: of torch.
        device: the torch device to train on.
        workers: processes that draw samples ahead.
    """

    out: Path
    resume: bool = False
    objects: Path | None = None
    scans: Path | None = None
    threads: int = 1
    device: str = "cpu"
    workers: int = 0


def read_training(network: str, file: Path | None, overrides: Mapping[str, Any]) -> LoftrTraining | MixvprTraining:
    """Read the settings of a training: the shipped file of that network, or another.

    Args:
        network: `loftr` or `mixvpr`.
        file: a YAML file, or None for the shipped one.
        overrides: dotted path -> value.

    Raises:
        ToolkitError: an unknown network, YAML that does not parse, an unknown key or a value that does not fit.
    """
    if network not in NETWORKS:
        raise ToolkitError(f"unknown network '{network}'{suggest(network, list(NETWORKS))}")
    path = file or shipped_settings("train")[network]
    what = "training settings"
    data = read_settings(path, what, "loop, pool and what the network needs")
    settings = validated(NETWORKS[network], data, f"{what} '{path}'").model_dump(mode="json")
    for key, value in overrides.items():
        assign(settings, key, value)
    return validated(NETWORKS[network], settings, f"{what} '{path}'")


def train(network: str, config: LoftrTraining | MixvprTraining, options: TrainOptions, progress: Progress) -> Path:
    """Train, evaluate and export; returns the exported file.

    Raises:
        ToolkitError: weights to start from cannot be had, the folder holds a training already or none to resume, a
            pool cannot be made, or torch cannot use the device.
    """
    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    _check_device(options.device)
    _check_folder(options)
    settings = config.model_dump(mode="json")
    identity: dict[str, Any] = {**settings, "loop": {k: v for k, v in settings["loop"].items() if k != "steps"}}
    cache = cache_root()
    if isinstance(config, LoftrTraining):
        start = resolve_weights(_STARTS[config.start]) if config.start in _STARTS else None
        task: Any = LoftrTask(config, cache, options.objects, options.scans, start, progress)
    else:
        start = resolve_weights("efficientnet-lite0")
        task = MixvprTask(config, cache, options.objects, options.scans, start, progress)
    identity["start_sha256"] = file_digest(start) if start else None
    if options.objects is not None:
        identity["objects"] = load_object_set(str(options.objects), cache).digest
    trainer = Trainer[Any](task, config.loop, options.out, identity, progress, options.device, options.workers)
    if options.resume:
        trainer.resume()
    options.out.mkdir(parents=True, exist_ok=True)
    write_text(options.out / "settings.yaml", yaml.safe_dump(settings, sort_keys=False))
    model = trainer.run()
    path = options.out / f"{network}_tabletop.safetensors"
    card = {
        "network": network,
        "data": task.data,
        "steps": trainer.step,
        "hours": round(trainer.seconds / 3600, 2),
        "metrics": {name: round(value, 4) for name, value in trainer.figures.items()},
        "settings": settings,
        "started_from": {"file": start.name, "sha256": file_digest(start)} if start else "random weights",
    }
    export(model, path, card, options.device)
    return path


def _check_device(device: str) -> None:
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise ToolkitError(
            f"torch cannot use the device '{device}' here; `toolkit doctor` lists those it has"
        ) from error


def _check_folder(options: TrainOptions) -> None:
    if (options.out / "checkpoint.pt").exists() and not options.resume:
        raise ToolkitError(f"'{options.out}' already holds a training; add --resume to go on, or use another --out")
    # Found out now: rendering takes minutes.
    if not may_write(options.out):
        raise ToolkitError(f"'{options.out}' cannot be written; use another --out")
