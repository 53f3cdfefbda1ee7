"""GMFlow with refinement (Xu et al., GMFlow: Learning Optical Flow via Global Matching, CVPR 2022).

Flow is found by comparing every pixel with every other at 1/8 of the image's size, and once more nearby at 1/4. Modules
are called as in the published checkpoints.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

_CHANNELS = 128
_MEAN = (0.485, 0.456, 0.406)
_STD = (0.229, 0.224, 0.225)
"""Colours as ImageNet's networks expect them."""

_WINDOWS = (1, 2)
"""Windows of attention per side, at 1/8 and at 1/4. Published are 2 and 8, for films; on crops of 160 pixels such
windows see too little (five features per side), and flow ends up at the nearest multiple of 8 pixels.
"""


class Gmflow(nn.Module):
    """The whole network, 4.7 M parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = Backbone()
        self.transformer = Transformer()
        self.feature_flow_attn = Propagation()
        self.upsampler = nn.Sequential(
            nn.Conv2d(2 + _CHANNELS, 256, 3, padding=1), nn.ReLU(), nn.Conv2d(256, 9 * 4 * 4, 1)
        )

    def forward(self, source: Tensor, target: Tensor) -> Tensor:
        """Return the (B, 2, H, W) flow (x, y), pixels, that takes source pixels to where the target shows the same.

        Args:
            source: (B, 3, H, W) RGB, 0..1; sides multiples of 8.
            target: likewise.
        """
        images = torch.cat([source, target])
        images = (images - images.new_tensor(_MEAN)[:, None, None]) / images.new_tensor(_STD)[:, None, None]
        fine, coarse = self.backbone(images)

        a, b = self.transformer(*coarse.chunk(2), windows=_WINDOWS[0])
        flow = self.feature_flow_attn(a, match_everywhere(a, b))

        flow = 2 * functional.interpolate(flow, scale_factor=2.0, mode="bilinear", align_corners=True)
        a, b = fine.chunk(2)
        a, b = self.transformer(a, warp(b, flow), windows=_WINDOWS[1])
        flow = self.feature_flow_attn(a, flow + match_nearby(a, b, radius=4), radius=1)
        return upsample(flow, self.upsampler(torch.cat([flow, a], dim=1)))


class Backbone(nn.Module):
    """(B, 3, H, W) images to (B, 128, H/4, W/4) and (B, 128, H/8, W/8) features."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, stride=2, padding=3, bias=False)
        self.layer1 = nn.Sequential(Residual(64, 64, 1), Residual(64, 64, 1))
        self.layer2 = nn.Sequential(Residual(64, 96, 2), Residual(96, 96, 1))
        self.layer3 = nn.Sequential(Residual(96, _CHANNELS, 1), Residual(_CHANNELS, _CHANNELS, 1))
        self.conv2 = nn.Conv2d(_CHANNELS, _CHANNELS, 1)
        self.trident_conv = nn.Conv2d(_CHANNELS, _CHANNELS, 3, padding=1, bias=False)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        x = functional.relu(functional.instance_norm(self.conv1(images)))
        x = self.conv2(self.layer3(self.layer2(self.layer1(x))))
        # One filter looks at both scales.
        return self.trident_conv(x), functional.conv2d(x, self.trident_conv.weight, stride=2, padding=1)


class Residual(nn.Module):
    """Two convolutions with instance normalisation, and the input added."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1, bias=False)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        same = stride == 1 and inputs == outputs
        self.downsample = None if same else nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride=stride))

    def forward(self, x: Tensor) -> Tensor:
        y = functional.relu(functional.instance_norm(self.conv1(x)))
        y = functional.relu(functional.instance_norm(self.conv2(y)))
        return functional.relu((x if self.downsample is None else functional.instance_norm(self.downsample(x))) + y)


class Transformer(nn.Module):
    """Two images' features, each seen in the light of the other's."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.ModuleList(Layer() for _ in range(6))

    def forward(self, a: Tensor, b: Tensor, windows: int) -> tuple[Tensor, Tensor]:
        """(B, C, H, W) twice; attention stays within `windows` windows per side, which every other layer shifts."""
        x = torch.cat([a, b]).permute(0, 2, 3, 1)
        height, width = x.shape[1:3]
        x = x + positions(height // windows, width // windows).to(x).repeat(windows, windows, 1)
        for number, layer in enumerate(self.layers):
            x = layer(x, torch.cat(x.chunk(2)[::-1]), Windows(height, width, windows, shifted=number % 2 == 1))
        first, second = x.permute(0, 3, 1, 2).chunk(2)
        return first, second


class Windows:
    """The division of an (H, W) grid into windows; shifted ones lie half a window further, and wrap around."""

    def __init__(self, height: int, width: int, count: int, *, shifted: bool) -> None:
        self.count, self.size = count, (height // count, width // count)
        self.shift = tuple(side // 2 for side in self.size) if shifted else (0, 0)
        self.mask: Tensor | None = None
        if shifted:
            # What wraps around was not beside what it now meets.
            wrapped = torch.zeros(1, height, width, 1, dtype=torch.int64)
            wrapped[:, height - self.shift[0] :] += 1
            wrapped[:, :, width - self.shift[1] :] += 2
            labels = self._cut(wrapped)[..., 0]
            self.mask = labels[:, :, None] == labels[:, None, :]

    def attend(self, query: Tensor, key: Tensor, value: Tensor) -> Tensor:
        """Attention within the windows, (B, H, W, C) each."""
        down, right = self.shift
        q, k, v = (self._cut(x.roll((-down, -right), dims=(1, 2)))[:, None] for x in (query, key, value))
        mask = None if self.mask is None else self.mask.to(q.device).repeat(len(query), 1, 1)[:, None]
        found = functional.scaled_dot_product_attention(q, k, v, attn_mask=mask)
        return self._join(found[:, 0], query.shape).roll(self.shift, dims=(1, 2))

    def _cut(self, x: Tensor) -> Tensor:
        n, (h, w) = self.count, self.size
        return x.reshape(-1, n, h, n, w, x.shape[-1]).transpose(2, 3).reshape(-1, h * w, x.shape[-1])

    def _join(self, x: Tensor, shape: torch.Size) -> Tensor:
        n, (h, w) = self.count, self.size
        return x.reshape(-1, n, n, h, w, shape[-1]).transpose(2, 3).reshape(shape)


class Layer(nn.Module):
    """Attention to the own image, then to the other one."""

    def __init__(self) -> None:
        super().__init__()
        self.self_attn = Attention(feed_forward=False)
        self.cross_attn_ffn = Attention(feed_forward=True)

    def forward(self, x: Tensor, other: Tensor, windows: Windows) -> Tensor:
        return self.cross_attn_ffn(self.self_attn(x, x, windows), other, windows)


class Attention(nn.Module):
    """Attention with one head; its message is added to the input."""

    def __init__(self, *, feed_forward: bool) -> None:
        super().__init__()
        self.q_proj = nn.Linear(_CHANNELS, _CHANNELS, bias=False)
        self.k_proj = nn.Linear(_CHANNELS, _CHANNELS, bias=False)
        self.v_proj = nn.Linear(_CHANNELS, _CHANNELS, bias=False)
        self.merge = nn.Linear(_CHANNELS, _CHANNELS, bias=False)
        self.norm1 = nn.LayerNorm(_CHANNELS)
        self.mlp: nn.Sequential | None = None
        if feed_forward:
            wide = 8 * _CHANNELS
            self.mlp = nn.Sequential(
                nn.Linear(2 * _CHANNELS, wide, bias=False), nn.GELU(), nn.Linear(wide, _CHANNELS, bias=False)
            )
            self.norm2 = nn.LayerNorm(_CHANNELS)

    def forward(self, x: Tensor, other: Tensor, windows: Windows) -> Tensor:
        message = windows.attend(self.q_proj(x), self.k_proj(other), self.v_proj(other))
        message = self.norm1(self.merge(message))
        if self.mlp is not None:
            message = self.norm2(self.mlp(torch.cat([x, message], dim=-1)))
        return x + message


class Propagation(nn.Module):
    """Flow passed on to pixels that look alike, so that hidden ones get some."""

    def __init__(self) -> None:
        super().__init__()
        self.q_proj = nn.Linear(_CHANNELS, _CHANNELS)
        self.k_proj = nn.Linear(_CHANNELS, _CHANNELS)

    def forward(self, features: Tensor, flow: Tensor, radius: int | None = None) -> Tensor:
        """(B, C, H, W) features and (B, 2, H, W) flow to flow; from the whole image, or from a neighbourhood."""
        pixels = features.permute(0, 2, 3, 1)
        query = self.q_proj(pixels)
        if radius is None:
            # The published weights were trained with keys made of the queries, here and not below.
            key = self.k_proj(query)
            values = flow.permute(0, 2, 3, 1).flatten(1, 2)
            found = functional.scaled_dot_product_attention(query.flatten(1, 2), key.flatten(1, 2), values)
            return found.transpose(1, 2).reshape(flow.shape)
        near = neighbours(self.k_proj(pixels).permute(0, 3, 1, 2), radius)
        weights = torch.einsum("bhwc,bckhw->bkhw", query, near) / _CHANNELS**0.5
        return torch.einsum("bkhw,bckhw->bchw", weights.softmax(dim=1), neighbours(flow, radius))


def positions(height: int, width: int) -> Tensor:
    """(H, W, C) sines and cosines of where a pixel is: half of the channels say y, half x."""
    half = _CHANNELS // 2
    wave = 10000 ** (torch.arange(0, half, 2) / half)

    def code(side: int) -> Tensor:
        angle = 2 * torch.pi * torch.arange(1, side + 1)[:, None] / side / wave
        return torch.stack([angle.sin(), angle.cos()], dim=-1).flatten(1)

    y, x = code(height)[:, None].expand(-1, width, -1), code(width)[None].expand(height, -1, -1)
    return torch.cat([y, x], dim=-1)


def grid(like: Tensor) -> Tensor:
    """(2, H, W) the position (x, y) of every pixel of (..., H, W)."""
    y, x = torch.meshgrid(*(torch.arange(side).to(like) for side in like.shape[-2:]), indexing="ij")
    return torch.stack([x, y])


def match_everywhere(a: Tensor, b: Tensor) -> Tensor:
    """(B, 2, H, W) flow to the mean place in `b` that looks like the pixel of `a`."""
    xy = grid(a)
    places = xy.flatten(1).T.expand(len(a), -1, -1)
    found = functional.scaled_dot_product_attention(a.flatten(2).transpose(1, 2), b.flatten(2).transpose(1, 2), places)
    return found.transpose(1, 2).reshape(-1, *xy.shape) - xy


def match_nearby(a: Tensor, b: Tensor, radius: int) -> Tensor:
    """As `match_everywhere`, among the pixels no further than `radius` either way."""
    height, width = a.shape[2:]
    padded, places = functional.pad(b, [radius] * 4), range(2 * radius + 1)
    # One place after the other: all neighbours' features at once would be far more memory than work.
    scores = torch.stack(
        [(a * padded[:, :, y : y + height, x : x + width]).sum(dim=1) for y in places for x in places], dim=1
    )
    scores = scores / _CHANNELS**0.5
    exists = neighbours(torch.ones_like(b[:1, :1]), radius)[:, 0] > 0
    steps = torch.arange(-radius, radius + 1).to(a)
    dy, dx = torch.meshgrid(steps, steps, indexing="ij")
    weights = scores.masked_fill(~exists, -torch.inf).softmax(dim=1)
    return torch.einsum("bkhw,ck->bchw", weights, torch.stack([dx, dy]).flatten(1))


def neighbours(x: Tensor, radius: int) -> Tensor:
    """(B, C, H, W) to (B, C, (2 radius + 1)^2, H, W), row by row; zeros beyond the border."""
    side = 2 * radius + 1
    return functional.unfold(x, side, padding=radius).reshape(*x.shape[:2], side**2, *x.shape[2:])


def warp(features: Tensor, flow: Tensor) -> Tensor:
    """(B, C, H, W) features fetched from where the (B, 2, H, W) flow points; zeros beyond the border."""
    height, width = features.shape[2:]
    last = flow.new_tensor([width - 1, height - 1])[:, None, None]
    where = 2 * (grid(flow) + flow) / last - 1
    return functional.grid_sample(features, where.permute(0, 2, 3, 1), align_corners=True)


def upsample(flow: Tensor, logits: Tensor) -> Tensor:
    """(B, 2, h, w) flow to (B, 2, 4h, 4w): every pixel a weighted mean of the nine coarse ones about it."""
    batch, _, height, width = flow.shape
    weights = logits.reshape(batch, 9, 4, 4, height, width).softmax(dim=1)
    fine = torch.einsum("bkijhw,bckhw->bchiwj", weights, neighbours(4 * flow, 1))
    return fine.reshape(batch, 2, 4 * height, 4 * width)
