"""Segment Anything behind prompts (Kirillov et al., ICCV 2023), as the ONNX files of MobileSAM on onnxruntime."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import onnxruntime

from toolkit.errors import ToolkitError
from toolkit.types import Float, Image, Mask

SIDE = 1024
"""Side of the square the encoder sees; the image fills it from the top left."""

_MASK_SIDE = 256
_MEAN = np.array([123.675, 116.28, 103.53], np.float32)
_DEVIATION = np.array([58.395, 57.12, 57.375], np.float32)
_STABILITY_MARGIN = 1.0
_INSIDE, _PADDING = 1.0, -1.0
_ENCODER_INPUTS = {"input"}
_DECODER_INPUTS = {"image_embeddings", "point_coords", "point_labels", "mask_input", "has_mask_input", "orig_im_size"}


@dataclass(frozen=True, eq=False)
class SamMask:
    """One answer of the decoder.

    Attributes:
        mask: (H, W) bool.
        quality: the decoder's own estimate of the mask's IoU with the object.
        stability: IoU of the masks at a logit of +1 and of -1: near 1 where the border is sharp.
    """

    mask: Mask
    quality: float
    stability: float


@dataclass(frozen=True, eq=False)
class EncodedImage:
    """An image ready for prompts: (1, 256, 64, 64) float32 embedding, and its height and width in pixels."""

    embedding: Float
    height: int
    width: int

    @property
    def scale(self) -> float:
        """Encoder pixels per image pixel."""
        return SIDE / max(self.height, self.width)


class Sam:
    """Encoder and decoder sessions.

    Args:
        encoder: ONNX file that takes a normalised (1, 3, 1024, 1024) image.
        decoder: ONNX file with the inputs of Segment Anything's own export.

    Raises:
        ToolkitError: a file is damaged, or is another network.
    """

    def __init__(self, encoder: Path, decoder: Path) -> None:
        self._encoder = _session(encoder, _ENCODER_INPUTS, "SAM's image encoder")
        self._decoder = _session(decoder, _DECODER_INPUTS, "SAM's mask decoder")

    def encode(self, rgb: Image) -> EncodedImage:
        """Embed an (H, W, 3) uint8 image; one pass of the encoder."""
        height, width = rgb.shape[:2]
        scale = SIDE / max(height, width)
        size = (round(width * scale), round(height * scale))
        resized = cv2.resize(rgb, size, interpolation=cv2.INTER_LINEAR if scale >= 1 else cv2.INTER_AREA)
        padded = np.zeros((SIDE, SIDE, 3), np.float32)
        padded[: size[1], : size[0]] = (resized - _MEAN) / _DEVIATION
        (embedding,) = self._encoder.run(None, {"input": padded.transpose(2, 0, 1)[None]})
        return EncodedImage(np.asarray(embedding, np.float32), height, width)

    def at_points(self, image: EncodedImage, points: Float) -> SamMask:
        """The mask that (N, 2) pixels lie in."""
        # The decoder wants one more point where there is no box.
        coordinates = np.concatenate([np.asarray(points, np.float32), np.zeros((1, 2), np.float32)])
        return self._decode(image, coordinates, [*[_INSIDE] * len(points), _PADDING])

    def _decode(self, image: EncodedImage, coordinates: Float, labels: list[float]) -> SamMask:
        # The decoder adds half a pixel itself, after the scaling.
        scaled = ((coordinates + 0.5) * image.scale - 0.5).astype(np.float32)
        masks, quality, _ = self._decoder.run(
            None,
            {
                "image_embeddings": image.embedding,
                "point_coords": scaled[None],
                "point_labels": np.array([labels], np.float32),
                "mask_input": np.zeros((1, 1, _MASK_SIDE, _MASK_SIDE), np.float32),
                "has_mask_input": np.zeros(1, np.float32),
                "orig_im_size": np.array([image.height, image.width], np.float32),
            },
        )
        logits = np.asarray(masks)[0, 0]
        inner, outer = (logits > _STABILITY_MARGIN).sum(), (logits > -_STABILITY_MARGIN).sum()
        return SamMask(logits > 0, float(np.asarray(quality).ravel()[0]), float(inner / max(outer, 1)))


def _session(path: Path, inputs: set[str], what: str) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:
        # onnxruntime's exceptions share no base class, and their text runs over many lines.
        raise ToolkitError(f"weights file '{path}' is damaged, or is not an ONNX network") from error
    if {i.name for i in session.get_inputs()} != inputs:
        raise ToolkitError(f"'{path}' is not {what}: its inputs have other names")
    return session
