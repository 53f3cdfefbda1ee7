"""LoFTR in two halves: what a crop needs once, and what a pair of crops needs.

The layers and their order are kornia's (`kornia.feature.LoFTR`), and so are the matches. Besides the backbone, the
first self-attention looks at one crop alone; it is part of the first half. In the small LoFTR, masked cells take no
part and are left out of every layer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from kornia.feature import LoFTR
from torch import Tensor

from toolkit.models.loftr_small import masked_tokens, scatter_tokens


@dataclass(frozen=True, eq=False)
class Encoded:
    """One crop's share of the work.

    Attributes:
        coarse: (K, C) coarse features after the first self-attention.
        cells: (K,) int64 their cells, row-major.
        fine: (1, C', h, w) fine features.
        grid: rows and columns of the coarse map.
    """

    coarse: Tensor
    cells: Tensor
    fine: Tensor
    grid: tuple[int, int]


@dataclass(frozen=True, eq=False)
class PairMatches:
    """Matches of all pairs of a batch.

    Attributes:
        pair: (M,) int64 number of the pair.
        xy0: (M, 2) float32 in kornia's frame: pixel (0, 0) has its centre at (0.5, 0.5).
        xy1: (M, 2) float32.
        confidence: (M,) float32.
    """

    pair: Tensor
    xy0: Tensor
    xy1: Tensor
    confidence: Tensor


def encode(model: LoFTR, images: Tensor, masks: Tensor | None = None) -> list[Encoded]:
    """The half that depends on one crop alone.

    Args:
        model: in evaluation mode; its first coarse layer is self-attention, as always in LoFTR.
        images: (N, 1, S, S) float32.
        masks: (N, S, S) bool; only cells whose first pixel is on it take part. None for all.
    """
    maps = model.extract_features(images)
    rows, columns = maps["coarse"].shape[2:]
    tokens = maps["coarse"].flatten(2).transpose(1, 2).contiguous()
    layer: Any = model.loftr_coarse.layers[0]
    if masks is None:
        cells = torch.arange(rows * columns, device=images.device).expand(len(images), -1)
        valid = torch.ones_like(cells, dtype=torch.bool)
        attended = layer(tokens, tokens)
    else:
        cells, valid = masked_tokens(masks)
        chosen = tokens[torch.arange(len(tokens), device=tokens.device)[:, None], cells]
        attended = layer(chosen, chosen, valid, valid)
    return [
        Encoded(attended[i, valid[i]], cells[i, valid[i]], maps["fine"][i : i + 1], (rows, columns))
        for i in range(len(images))
    ]


def match_encoded(model: LoFTR, query: Encoded, references: Sequence[Encoded]) -> PairMatches:
    """Match one crop to several in one batch; the same matches as kornia's forward on the same images.

    Similarities are compared in float32 under autocast too: bfloat16 cannot tell neighbouring cells apart.
    """
    n, (rows, columns) = len(references), query.grid
    whole = all(len(e.cells) == rows * columns for e in (query, *references))
    coarse0, cells0 = query.coarse.expand(n, -1, -1), query.cells.expand(n, -1)
    coarse1 = torch.nn.utils.rnn.pad_sequence([r.coarse for r in references], batch_first=True)
    cells1 = torch.nn.utils.rnn.pad_sequence([r.cells for r in references], batch_first=True)
    counts = torch.tensor([len(r.cells) for r in references], device=cells1.device)
    valid0 = torch.ones_like(cells0, dtype=torch.bool)
    valid1 = torch.arange(cells1.shape[1], device=cells1.device) < counts[:, None]
    masks = (None, None) if whole else (valid0, valid1)
    transformer: Any = model.loftr_coarse
    for layer, name in list(zip(transformer.layers, transformer.layer_names, strict=True))[1:]:
        if name == "self":
            coarse0, coarse1 = layer(coarse0, coarse0, masks[0], masks[0]), layer(coarse1, coarse1, masks[1], masks[1])
        else:
            coarse0 = layer(coarse0, coarse1, masks[0], masks[1])
            coarse1 = layer(coarse1, coarse0, masks[1], masks[0])
    stride, fine_stride = model.config["resolution"]
    # Where cells are left out there is no border to speak of, and tokens stand in one line.
    grids = (query.grid, references[0].grid) if whole else ((1, cells0.shape[1]), (1, cells1.shape[1]))
    data: dict[str, Any] = {"bs": n, "stride_c": stride, "stride_f": fine_stride, "hw0_c": grids[0], "hw1_c": grids[1]}
    kind = coarse0.device.type
    with torch.autocast(kind, enabled=False):
        model.coarse_matching(coarse0.float(), coarse1.float(), data, *masks)
    pair = data["b_ids"]
    data["i_ids"], data["j_ids"] = cells0[pair, data["i_ids"]], cells1[pair, data["j_ids"]]
    for side, cell in enumerate((data["i_ids"], data["j_ids"])):
        data[f"mkpts{side}_c"] = stride * torch.stack([cell % columns, cell // columns], dim=1).float()
    if not whole:
        coarse0 = scatter_tokens(coarse0, cells0, valid0, rows * columns)
        coarse1 = scatter_tokens(coarse1, cells1, valid1, rows * columns)
    fine0, fine1 = query.fine.expand(n, -1, -1, -1), torch.cat([r.fine for r in references])
    windows = model.fine_preprocess(fine0, fine1, coarse0, coarse1, data)
    if len(pair):
        windows = model.loftr_fine(*windows)
    with torch.autocast(kind, enabled=False):
        model.fine_matching(windows[0].float(), windows[1].float(), data)
    return PairMatches(pair, data["mkpts0_f"], data["mkpts1_f"], data["mconf"].float())
