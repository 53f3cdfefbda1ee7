"""Reading checkpoints: safetensors, or torch files without code. Nothing that can run code is ever opened."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from torch import Tensor
    from torch.nn import Module


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Read a state dict, on the CPU; a trainer's `state_dict` entry is unwrapped.

    Raises:
        ToolkitError: the file is damaged, or holds anything but tensors.
    """
    import torch
    from safetensors.torch import load_file

    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        state = torch.load(path, map_location="cpu", weights_only=True)
        return dict(state.get("state_dict", state))
    except Exception as error:
        # Both libraries report a damaged or foreign file in a dozen ways and over many lines.
        raise ToolkitError(f"weights file '{path}' is damaged, or is not a plain state dict") from error


def fill(module: Module, tensors: dict[str, Tensor], path: Path, architecture: str) -> None:
    """Load tensors into a module, all of them and nothing else.

    Args:
        module: receives them, and is put into evaluation mode.
        tensors: from `read_tensors`, with the module's own names.
        path: where they come from, for the message.
        architecture: what the module is, for the message.

    Raises:
        ToolkitError: the checkpoint belongs to another architecture; one difference is named.
    """
    own = module.state_dict()
    differences = [
        *(f"it lacks '{name}'" for name in own if name not in tensors),
        *(f"it holds '{name}'" for name in tensors if name not in own),
        *(
            f"'{name}' is {tuple(tensors[name].shape)} instead of {tuple(own[name].shape)}"
            for name in own
            if name in tensors and tensors[name].shape != own[name].shape
        ),
    ]
    if differences:
        raise ToolkitError(f"'{path}' is not a checkpoint of {architecture}: {differences[0]}")
    module.load_state_dict(tensors)
    module.eval()
