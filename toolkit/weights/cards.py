"""Weight cards: what every checkpoint is, where it comes from, and under which licence."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WeightCard:
    """One checkpoint.

    Attributes:
        name: how users ask for it.
        file: its file name, wherever it is kept.
        architecture: the network it fits.
        licence: SPDX name, or what its authors state.
        size_mb: about how much is downloaded.
        sources: `hf://owner/repo/file` or `https://...`, tried in this order.
        citation: the publication.
        sha256: of the file; None where its authors publish none and it could not be had to compute one. The digest of
            what was used is recorded in every result row either way.
    """

    name: str
    file: str
    architecture: str
    licence: str
    size_mb: float
    sources: tuple[str, ...]
    citation: str
    sha256: str | None = None


_LOFTR = "Sun et al., LoFTR: Detector-Free Local Feature Matching with Transformers, CVPR 2021"
_CMP = "https://cmp.felk.cvut.cz/~mishkdmy/models"

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
    )
}
"""Name -> card."""
