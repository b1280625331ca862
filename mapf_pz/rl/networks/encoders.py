"""Encoders of observations: built-in encoders by name, others as `package.module:Class`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import cast

import torch
from torch import Tensor, nn

from mapf_pz._internal.plugins import import_subclass
from mapf_pz.rl.config import EncoderName, ModelConfig
from mapf_pz.rl.networks.observation_shape import ObservationShape


class Encoder(nn.Module):
    """Encodes an image `(..., K, h, w)` and features `(..., F)` as an embedding `(..., hidden)`."""

    def __init__(self, shape: ObservationShape, config: ModelConfig) -> None:
        """Build the image layers and one linear layer; raises `ValueError` if `conv_channels` does not fit."""
        super().__init__()
        layers = IMAGE_LAYERS[cast("EncoderName", config.encoder)](shape.image, config)
        self.image = nn.Sequential(*layers, nn.Flatten())
        with torch.no_grad():
            size = self.image(torch.zeros(1, *shape.image)).shape[-1] + shape.features
        self.joint = nn.Sequential(scaled(nn.Linear(size, config.hidden)), nn.ReLU())

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Encode a batch of observations."""
        lead = image.shape[:-3]
        flat = self.image(image.reshape(-1, *image.shape[-3:])).reshape(*lead, -1)
        # In mixed precision, the layers' outputs have 16 bits, and those of 32 would be converted once more.
        return self.joint(flat if features is None else torch.cat([flat, features.to(flat.dtype)], -1))


class ResidualBlock(nn.Module):
    """ReLU, convolution, ReLU, convolution, with a skip connection; the shape `(B, C, h, w)` is preserved."""

    def __init__(self, width: int) -> None:
        """Build two 3 x 3 convolutions of `width` channels."""
        super().__init__()
        first, second = (scaled(nn.Conv2d(width, width, 3, padding=1)) for _ in range(2))
        self.layers = nn.Sequential(nn.ReLU(), first, nn.ReLU(), second)

    def forward(self, image: Tensor) -> Tensor:
        """Return the input plus the output of the layers."""
        return image + self.layers(image)


def conv_layers(image: tuple[int, int, int], config: ModelConfig) -> list[nn.Module]:
    """Return 3 x 3 convolutions with ReLU, without padding as long as the image is larger than 3 x 3."""
    channels, height, width = image
    layers: list[nn.Module] = []
    for out_channels in config.conv_channels:
        padding = 0 if min(height, width) > 3 else 1
        layers += [scaled(nn.Conv2d(channels, out_channels, 3, padding=padding)), nn.ReLU()]
        channels, height, width = out_channels, height - 2 + 2 * padding, width - 2 + 2 * padding
    return layers


def report_layers(image: tuple[int, int, int], config: ModelConfig) -> list[nn.Module]:
    """Return the report's two convolutions: 8 x 8 with stride 4, then 4 x 4 with stride 2.

    They need an image of at least 20 x 20, as in the report; smaller images use the layers of `conv` instead.
    """
    if len(config.conv_channels) != 2:
        raise ValueError(f"conv_channels={config.conv_channels}: the encoder 'report' has exactly two convolutions")
    channels, height, width = image
    if min(height, width) < 20:
        return conv_layers(image, config)
    first, second = config.conv_channels
    return [scaled(nn.Conv2d(channels, first, 8, 4)), nn.ReLU(), scaled(nn.Conv2d(first, second, 4, 2)), nn.ReLU()]


def residual_layers(image: tuple[int, int, int], config: ModelConfig) -> list[nn.Module]:
    """Return the stages of IMPALA's network (Espeholt et al., 2018): convolution, pooling and residual blocks.

    Images up to 11 x 11 are not pooled (Skrynnik et al., *Learn to Follow*, 2024): in a small view every cell matters.
    """
    channels, *size = image
    layers: list[nn.Module] = []
    for width in config.conv_channels:
        layers.append(scaled(nn.Conv2d(channels, width, 3, padding=1)))
        if max(size) > 11:
            layers.append(nn.MaxPool2d(3, stride=2, padding=1))
            size = [(side + 1) // 2 for side in size]
        layers += [ResidualBlock(width) for _ in range(config.num_blocks)]
        channels = width
    return [*layers, nn.ReLU()]


IMAGE_LAYERS: dict[EncoderName, Callable[[tuple[int, int, int], ModelConfig], list[nn.Module]]] = {
    "conv": conv_layers,
    "report": report_layers,
    "residual": residual_layers,
}
"""The layers for an image (K, h, w), by the encoder's name."""


def make_encoder(shape: ObservationShape, config: ModelConfig) -> nn.Module:
    """Return the encoder that `config` names; raises `ValueError` if `package.module:Class` is not an `nn.Module`.

    Observations that are stored in float16 are converted to float32 before the encoder reads them.
    """
    make = import_subclass("encoder", config.encoder, nn.Module) if ":" in config.encoder else Encoder
    encoder = make(shape, config)
    encoder.register_forward_pre_hook(_widen_inputs)
    return encoder


def _widen_inputs(_: nn.Module, inputs: tuple[Tensor | None, ...]) -> tuple[Tensor | None, ...]:
    """Return an encoder's inputs, the image and the features, as `widened`."""
    return tuple(None if part is None else widened(part) for part in inputs)


def widened(observations: Tensor) -> Tensor:
    """Return observations that are stored in float16 in float32, and others as they are."""
    return observations.float() if observations.dtype == torch.float16 else observations


def scaled(layer: nn.Linear | nn.Conv2d, scale: float = math.sqrt(2)) -> nn.Module:
    """Initialize weights orthogonally with gain `scale`, and biases with 0, as is best for PPO (Huang et al., 2022)."""
    nn.init.orthogonal_(layer.weight, scale)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)
    return layer
