"""Networks of the optional package transformers, read from folders; nothing is downloaded, only tensors are read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from toolkit.errors import ToolkitError

_PROCESSORS = {"GroundingDinoForObjectDetection": "GroundingDinoProcessor", "SamModel": "SamProcessor"}
"""Class of a network -> class of what prepares its inputs."""


def import_transformers() -> Any:
    """The module; raises ToolkitError saying what to install where it is absent."""
    try:
        import transformers
    except ImportError as error:
        raise ToolkitError(
            "grounded_sam needs the package transformers, which is not installed; "
            "run: pip install 'rearrange-toolkit[grounded-sam]'"
        ) from error
    return transformers


def load_pretrained(folder: Path, name: str, device: str) -> tuple[Any, Any]:
    """Load what `save_pretrained` wrote.

    Args:
        folder: configuration, processor and weights; the weights as safetensors.
        name: the network's class in transformers.
        device: torch device.

    Returns:
        The processor and the network, ready for inference.

    Raises:
        ToolkitError: transformers is not installed; the folder lacks a file, or holds a damaged one or another network.
    """
    transformers = import_transformers()
    architecture, kind = getattr(transformers, name), _PROCESSORS[name]
    try:
        model_type = json.loads((folder / "config.json").read_text())["model_type"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ToolkitError(f"'{folder}' holds no config.json of a network of transformers") from error
    if model_type != architecture.config_class.model_type:
        raise ToolkitError(f"'{folder}' is not a {name}: its config.json says '{model_type}'")
    try:
        processor = getattr(transformers, kind).from_pretrained(folder, local_files_only=True)
        network, report = architecture.from_pretrained(
            folder, local_files_only=True, use_safetensors=True, output_loading_info=True
        )
    except Exception as error:
        # transformers reports absent, damaged and foreign files in a dozen ways and over many lines.
        raise ToolkitError(
            f"'{folder}' cannot be loaded as {name} and {kind}: {str(error).strip().splitlines()[0]}"
        ) from error
    if report["missing_keys"]:
        # transformers would go on with random values.
        lacking = sorted(report["missing_keys"])[0]
        raise ToolkitError(f"the weights in '{folder}' are not those of its config.json: they lack '{lacking}'")
    return processor, network.eval().to(device)
