"""A trained network as a file to ship: tensors in half precision, and a card that says how it came about."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
import yaml
from safetensors.torch import save_file
from torch import nn

from toolkit import __version__
from toolkit.files import new_file, write_text


def export(model: nn.Module, path: Path, card: Mapping[str, Any], device: str = "cpu") -> None:
    """Write `path` (safetensors, float16 where the tensor is floating) and, beside it, the card as YAML.

    Args:
        model: its state dict is what is written.
        path: ends in `.safetensors`.
        card: what to say of it; size, digest, machine and versions are added.
        device: what it was trained on.
    """
    state = {
        name: (value.half() if value.is_floating_point() else value).cpu().contiguous()
        for name, value in model.state_dict().items()
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with new_file(path) as temporary:
        save_file(state, temporary)
    data = path.read_bytes()
    facts = {
        **card,
        "parameters": sum(p.numel() for p in model.parameters()),
        "file": path.name,
        "size_mb": round(len(data) / 1e6, 2),
        "sha256": hashlib.sha256(data).hexdigest(),
        "machine": _machine(device),
        "versions": {"toolkit": __version__, "torch": str(torch.__version__), "python": platform.python_version()},
    }
    write_text(path.with_suffix(".yaml"), yaml.safe_dump(facts, sort_keys=False, width=110))


def _machine(device: str) -> str:
    if torch.device(device).type == "cuda":
        return f"{torch.cuda.get_device_name(device)}, {_processor()}"
    return f"{_processor()}, {torch.get_num_threads()} thread(s)"


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())
