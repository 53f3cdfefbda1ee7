"""Objects that a text names: boxes by Grounding DINO, a mask in every box by Segment Anything (Grounded SAM)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from toolkit.perception.segmenters.networks.pretrained import import_transformers, load_pretrained
from toolkit.perception.stages import Segmenter
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Frame, Mask, Segment
from toolkit.weights.resolve import file_digest, resolve_folder

_LEAST_LEFT = 0.5
"""A mask of which better masks leave less than this share shows the same object again, or a group of objects."""


class GroundedSamConfig(PluginConfig):
    """Settings of the `grounded_sam` segmenter."""

    prompt: str = Field("objects", min_length=1, description="What to find; full stops separate several things.")
    box_threshold: float = Field(0.25, ge=0, le=1, description="Least score of a box.")
    text_threshold: float = Field(0.25, ge=0, le=1, description="Least score of the word that a box stands for.")
    min_pixels: int = Field(60, ge=1, description="Segments with fewer pixels are dropped.")
    detector: Path | None = Field(None, description="Folder with your own Grounding DINO, as transformers saves it.")
    sam: Path | None = Field(None, description="Folder with your own SAM, as transformers saves it.")
    device: str = Field("cpu", description="Torch device.")


class GroundedSamSegmenter(Plugin[GroundedSamConfig], Segmenter):
    """Grounding DINO (Liu et al., ECCV 2024) and SAM (Kirillov et al., ICCV 2023), the paper's segmenter.

    Both are transformers' (`pip install rearrange-toolkit[grounded-sam]`). Depth is not used. Where masks overlap, the
    better box has the pixels. Segments come in row-major order of their first pixel.
    """

    stage = "segmenter"
    name = "grounded_sam"
    weights = ("grounding-dino-tiny", "sam-vit-base")

    def check_ready(self) -> None:
        """Load both networks, so that a missing package or checkpoint stops the command before any work."""
        _ = self._detector, self._sam

    def digests(self) -> dict[str, str]:
        """Digests of all files that the networks are made from, by role and name."""
        roles = zip(("detector", "sam"), self._folders, strict=True)
        return {
            f"{role}/{path.name}": file_digest(path)
            for role, folder in roles
            for path in sorted(folder.iterdir())
            if path.suffix in (".safetensors", ".json", ".txt")
        }

    def segment(self, frame: Frame, current: Sequence[Frame]) -> list[Segment]:
        """Return what the prompt names; the current frames are not looked at."""
        import torch

        settings, size = self.config, frame.rgb.shape[:2]
        (read_detector, detector), (read_sam, sam) = self._detector, self._sam
        text = settings.prompt.lower().strip().rstrip(".") + "."
        with torch.inference_mode():
            inputs = read_detector(images=frame.rgb, text=text, return_tensors="pt").to(settings.device)
            (found,) = read_detector.post_process_grounded_object_detection(
                detector(**inputs), inputs["input_ids"], settings.box_threshold, settings.text_threshold, [size]
            )
            named = [k for k, words in enumerate(found["text_labels"]) if words]
            if not named:
                return []
            boxes, scores = found["boxes"][named].cpu().tolist(), found["scores"][named].cpu().numpy()
            inputs = read_sam(frame.rgb, input_boxes=[boxes], return_tensors="pt").to(settings.device, torch.float32)
            sizes = inputs.pop("original_sizes"), inputs.pop("reshaped_input_sizes")
            logits = sam(**inputs, multimask_output=False).pred_masks
            (masks,) = read_sam.image_processor.post_process_masks(logits.cpu(), *sizes)
        return disjoint(masks[:, 0].numpy(), scores, settings.min_pixels)

    @cached_property
    def _folders(self) -> tuple[Path, Path]:
        settings = self.config
        # Without it, hundreds of megabytes would be fetched for nothing.
        import_transformers()
        return resolve_folder("grounding-dino-tiny", settings.detector), resolve_folder("sam-vit-base", settings.sam)

    @cached_property
    def _detector(self) -> tuple[Any, Any]:
        return load_pretrained(self._folders[0], "GroundingDinoForObjectDetection", self.config.device)

    @cached_property
    def _sam(self) -> tuple[Any, Any]:
        return load_pretrained(self._folders[1], "SamModel", self.config.device)


def disjoint(masks: Mask, scores: np.ndarray, min_pixels: int) -> list[Segment]:
    """Make masks that overlap disjoint: better ones keep what they have, and what is left of a mask is its segment.

    Args:
        masks: (N, H, W) bool.
        scores: (N,) in 0..1.
        min_pixels: smaller segments are dropped.
    """
    taken = np.zeros(masks.shape[1:], bool)
    kept: list[Segment] = []
    for k in np.argsort(-scores, kind="stable"):
        left = masks[k] & ~taken
        if left.sum() >= max(min_pixels, _LEAST_LEFT * masks[k].sum()):
            kept.append(Segment(left, float(scores[k])))
            taken |= left
    return sorted(kept, key=lambda segment: int(segment.mask.argmax()))
