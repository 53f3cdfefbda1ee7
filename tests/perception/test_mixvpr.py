"""MixVPR against its published equations in plain NumPy, and against the shapes of its official checkpoint."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from toolkit.errors import ToolkitError
from toolkit.models.efficientnet_lite import EfficientNetLite0, load_efficientnet
from toolkit.models.mixvpr import MixVPR, gem, mixer_lite, mixvpr_lite, mixvpr_resnet50
from toolkit.stages import DESCRIPTORS


def published_forward(state, maps):
    """The paper's Sec. 3: every channel's map flattened, L feature mixers, depth-wise then row-wise projection, L2."""
    x = maps.reshape(len(maps), maps.shape[1], -1).astype(np.float64)
    depth = 1 + max(int(name.split(".")[1]) for name in state if name.startswith("mix."))
    for i in range(depth):
        gain, shift, w1, b1, w2, b2 = (
            state[f"mix.{i}.mix.{part}"] for part in ("0.weight", "0.bias", "1.weight", "1.bias", "3.weight", "3.bias")
        )
        mean, variance = x.mean(axis=-1, keepdims=True), x.var(axis=-1, keepdims=True)
        normed = (x - mean) / np.sqrt(variance + 1e-5) * gain + shift
        x = x + np.maximum(normed @ w1.T + b1, 0) @ w2.T + b2
    depthwise = np.einsum("dc,ncp->ndp", state["channel_proj.weight"], x) + state["channel_proj.bias"][:, None]
    rows = depthwise @ state["row_proj.weight"].T + state["row_proj.bias"]
    flat = rows.reshape(len(rows), -1)
    return flat / np.linalg.norm(flat, axis=1, keepdims=True)


def test_the_forward_is_the_published_one():
    torch.manual_seed(0)
    model = MixVPR(channels=12, side=5, out_channels=7, out_rows=3, depth=3).eval()
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    maps = torch.randn(4, 12, 5, 5)
    state = {name: value.double().numpy() for name, value in model.state_dict().items()}
    with torch.inference_mode():
        ours = model(maps).numpy()
    np.testing.assert_allclose(ours, published_forward(state, maps.numpy()), atol=1e-5)


def official_shapes():
    """Names and shapes of the official checkpoint: torchvision's ResNet50 without layer4 and fc, and the mixer."""
    shapes = {"conv1.weight": (64, 3, 7, 7)}

    def norm(name, width):
        shapes.update({f"{name}.{part}": (width,) for part in ("weight", "bias", "running_mean", "running_var")})
        shapes[f"{name}.num_batches_tracked"] = ()

    norm("bn1", 64)
    width = 64
    for stage, (inner, blocks) in enumerate(((64, 3), (128, 4), (256, 6)), start=1):
        for block in range(blocks):
            at = f"layer{stage}.{block}"
            sizes = ((inner, width, 1, 1), (inner, inner, 3, 3), (4 * inner, inner, 1, 1))
            for i, size in enumerate(sizes, start=1):
                shapes[f"{at}.conv{i}.weight"] = size
                norm(f"{at}.bn{i}", size[0])
            if block == 0:
                shapes[f"{at}.downsample.0.weight"] = (4 * inner, width, 1, 1)
                norm(f"{at}.downsample.1", 4 * inner)
            width = 4 * inner
    shapes = {f"backbone.model.{name}": shape for name, shape in shapes.items()}
    for i in range(4):
        for part in ("0.weight", "0.bias", "1.bias", "3.bias"):
            shapes[f"aggregator.mix.{i}.mix.{part}"] = (400,)
        for part in ("1.weight", "3.weight"):
            shapes[f"aggregator.mix.{i}.mix.{part}"] = (400, 400)
    projections = {"channel_proj.weight": (1024, 1024), "channel_proj.bias": (1024,)}
    projections |= {"row_proj.weight": (4, 400), "row_proj.bias": (4,)}
    return shapes | {f"aggregator.{name}": shape for name, shape in projections.items()}


def test_the_official_checkpoint_would_fit():
    own = {name: tuple(value.shape) for name, value in mixvpr_resnet50().state_dict().items()}
    assert own == official_shapes()
    trained = sum(np.prod(s) for n, s in own.items() if "running" not in n and "num_batches" not in n)
    # The paper's Table 4 gives 10.88 million.
    assert round(trained / 1e6, 2) == 10.88


def test_resnet50_at_320_pixels_gives_what_the_mixer_takes():
    with torch.inference_mode():
        net = mixvpr_resnet50().eval()
        assert net(torch.zeros(1, 3, 320, 320)).shape == (1, 4096)


def test_efficientnet_has_the_published_names_and_pads_as_tensorflow():
    """A stride-2 convolution of TensorFlow's `SAME` on an even size pads below and to the right only."""
    names = set(EfficientNetLite0(7).state_dict())
    assert {"_conv_stem.weight", "_blocks.0._depthwise_conv.weight", "_blocks.15._project_conv.weight"} <= names
    net = EfficientNetLite0(1).eval()
    corner = torch.zeros(1, 3, 32, 32)
    corner[..., 0, 0] = 1.0
    with torch.inference_mode():
        stem = net._conv_stem(net._pad(corner))
    torch.testing.assert_close(stem[0, :, 0, 0], net._conv_stem.weight[:, :, 0, 0].sum(dim=1))


def test_gem_lies_between_mean_and_maximum():
    maps = torch.rand(2, 5, 4, 4) + 0.1
    torch.testing.assert_close(gem(maps, 1.0), torch.nn.functional.normalize(maps.mean(dim=(2, 3)), dim=1))
    sharp = torch.nn.functional.normalize(maps.amax(dim=(2, 3)), dim=1)
    torch.testing.assert_close(gem(maps, 200.0), sharp, atol=0.02, rtol=0)


def test_a_checkpoint_of_another_network_is_one_sentence(tmp_path):
    torch.save(mixer_lite().state_dict(), tmp_path / "mixer.pt")
    with pytest.raises(ToolkitError, match="EfficientNet-Lite0's published weights") as error:
        load_efficientnet(tmp_path / "mixer.pt")
    assert "\n" not in str(error.value)
    with pytest.raises(ToolkitError, match="not a checkpoint of MixVPR over ResNet50"):
        DESCRIPTORS.create("mixvpr", {"backbone": "resnet50", "file": str(tmp_path / "mixer.pt")}).check_ready()


def test_the_light_network_takes_160_pixels():
    with torch.inference_mode():
        rows = mixvpr_lite(EfficientNetLite0()).eval()(torch.randn(2, 3, 160, 160))
    assert rows.shape == (2, 512)
    torch.testing.assert_close(rows.norm(dim=1), torch.ones(2))
