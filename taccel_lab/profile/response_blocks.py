# SPDX-License-Identifier: Apache-2.0
"""The optional blocks that say how a sensor answers a touch, besides its colour model: the inverse
model from colour to surface, the force behind an image, the depth of a grey sensor, and how far
units and days differ."""

from __future__ import annotations

from itertools import pairwise
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from taccel_lab.files.strict_model import Number
from taccel_lab.profile.schema import Block, ConfigValue, Name

Triple = tuple[Number, Number, Number]


class NormalsBlock(Block):
    """The model from colour and pixel position to surface normal.

    Its weights are stored in ``normal_model.safetensors``.
    """

    key: ClassVar[str] = "normals"

    file: Literal["normal_model.safetensors"] = "normal_model.safetensors"
    architecture: dict[Name, ConfigValue]
    """What is needed to rebuild the network: features, layer widths, activation, scales."""


class ForceBlock(Block):
    """The network from the change of colour, and moved markers, to force, moment and area.

    Its weights are stored in ``force_model.safetensors``.
    """

    key: ClassVar[str] = "force"

    file: Literal["force_model.safetensors"] = "force_model.safetensors"
    architecture: dict[Name, ConfigValue]
    """What is needed to rebuild the network: patches, layer widths, scales, limits, modulus."""


class DepthResponseBlock(Block):
    """Indentation of a grey sensor (9DTact) from how far a pixel darkens: a monotone curve."""

    key: ClassVar[str] = "depth_response"

    channel: Literal["grey", "red", "green", "blue"] = "grey"
    """Channel whose drop is read; grey is OpenCV's luma 0.299 R + 0.587 G + 0.114 B."""
    drop_levels: tuple[Number, ...] = Field(min_length=2)
    """Background minus image [levels of 255], rising."""
    depth_mm: tuple[Number, ...] = Field(min_length=2)
    """Indentation of the contact face at each drop [mm], not falling."""
    reading_sigma_mm: Number | None = None
    """Standard deviation of a pixel's depth about the curve on presses that it did not see [mm];
    None where it is not known, and the two below then are not either."""
    zero_sigma_mm: Number = 0.0
    """Standard deviation of the zero [mm], which all depths from the second entry on share; below
    it runs straight to none, since untouched gel is at zero whatever the zero is."""
    depth_share: Number = 0.0
    """Standard deviation, as a share of the depth, by the scale that the calibration took."""

    @model_validator(mode="after")
    def _check_curve(self) -> Self:
        drop, depth = self.drop_levels, self.depth_mm
        if len(drop) != len(depth):
            raise ValueError(f"drop_levels has {len(drop)} entries, depth_mm {len(depth)}")
        if any(b <= a for a, b in pairwise(drop)):
            raise ValueError("drop_levels must rise")
        if any(b < a for a, b in pairwise(depth)):
            raise ValueError("depth_mm must not fall")
        return self


class PerturbationBlock(Block):
    """How far captures of this sensor spread, for domain randomisation; standard deviations.

    A perturbed image is ``pivot + gain * (image - pivot) + offset + gradient + noise``; see
    ``taccel_lab.signals.perturbation``.
    """

    key: ClassVar[str] = "perturbation"

    gain_rgb: Triple = (0.0, 0.0, 0.0)
    """Standard deviation of the per-frame gain of each channel."""
    pivot_rgb: Triple = (0.0, 0.0, 0.0)
    """Level of each channel that its gain leaves as it is, usually the mean of the background:
    about it gain and offset vary independently [levels]; not a spread."""
    offset_rgb: Triple = (0.0, 0.0, 0.0)
    """Standard deviation of the per-frame offset of each channel, at the pivot [levels]."""
    gradient_rgb: Triple = (0.0, 0.0, 0.0)
    """Standard deviation of a linear gradient of the light over half the image [levels]."""
    noise_levels: Number = 0.0
    """Standard deviation of one pixel between frames [levels]."""
    mm_per_px_relative: Number = 0.0
    """Standard deviation of the scale, as a part of it."""
    center_px: Number = 0.0
    """Standard deviation of the gel's place in the image [px]."""
    young_modulus_relative: Number = 0.0
    """Standard deviation of Young's modulus, as a part of it."""
    friction_coefficient: Number = 0.0
    """Standard deviation of the coefficient of friction."""
