# SPDX-License-Identifier: Apache-2.0
"""Settings of force models (``force_model``): sizes, scales, limits, as a profile stores them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.signals.model_settings import reading_settings, settings_dict

TARGETS = ("fx_n", "fy_n", "fz_n", "tx_nmm", "ty_nmm", "tz_nmm", "area_mm2")
"""What has a standard deviation, in order: force, moment about the gel's origin, area."""
LEVELS = 32.0
"""Change of colour that counts as one in the network [levels of 255]."""
STATISTICS = 13
"""Of the change of colour: by channel mean, logarithms of the standard deviation and of that of the
Laplacian; correlations of channels; logarithm of the largest change."""
MARKER_PLANES = 3
"""Motion along x and y, and how many markers tell it."""
MARKER_UNIT_MM = 0.2
"""Motion of markers that counts as one in the network."""
LOG_SIGMA = (-7.0, 3.0)
"""Logarithms of standard deviations, over the spread of the training, are kept in this range."""
STD_FLOOR = 0.25
"""Levels that are added to a standard deviation before its logarithm is taken."""


@dataclass(frozen=True)
class ForceModelConfig:
    """Everything besides the weights that is needed to rebuild a ``ForceModel``."""

    width_px: int
    """Of the camera's images."""
    height_px: int
    columns: int
    """Of patches, side by side over the image."""
    rows: int
    patch_px: int = 16
    """Pixels across a patch that the network sees; a power of two."""
    widths: tuple[int, ...] = (16, 32, 64, 96)
    """Channels of the layers that each halve the picture, down to a pixel a patch."""
    blocks: int = 3
    """Layers at a pixel a patch after them."""
    hidden: int = 64
    """Last features, on which standard deviations and the range go."""
    markers: bool = False
    """Whether moved markers are seen, too."""
    marker_reach_mm: float = 1.0
    """Markers tell a patch's motion with weights exp(-(distance / reach)^2 / 2)."""
    patch_scale_n: tuple[float, ...] = (1.0, 1.0, 1.0)
    """Spread of patch forces (x, y, z) in the training."""
    target_scale: tuple[float, ...] = (1.0,) * len(TARGETS)
    """Spread of ``TARGETS`` in the training."""
    sigma_factor: tuple[float, ...] = (1.0,) * len(TARGETS)
    """Factor on the standard deviations, found on objects that the training did not see."""
    young_modulus_pa: float = 1e5
    """Of the gel that forces are predicted for."""
    stiffness_relative: float = 0.0
    """Standard deviation of a unit's modulus, as a part of it."""
    most: tuple[float, ...] = (math.inf,) * 4
    """Largest force along z [N], force along the face [N], area [mm2] and force of a patch along z
    [N] of the training."""
    distance_limits: tuple[float, ...] = (math.inf,) * 3
    """From which an image is outside: Mahalanobis distances of features and of statistics, and
    ``color_reach`` over the training's largest."""

    def __post_init__(self) -> None:
        sizes = (self.width_px, self.height_px, self.columns, self.rows, self.patch_px, self.hidden)
        if min(sizes) < 1 or max(sizes) > 20_000:
            raise InputError("force model sizes must lie in 1..20000")
        halvings = len(self.widths)
        if self.patch_px != 2**halvings or not 1 <= halvings <= 8:
            raise InputError(
                f"force model: {halvings} widths halve the picture {halvings} times, so that "
                f"patch_px must be {2**halvings}, not {self.patch_px}"
            )
        if not all(1 <= width <= 4096 for width in self.widths) or not 0 <= self.blocks <= 64:
            raise InputError("force model widths must lie in 1..4096 and blocks in 0..64")
        if self.rows * self.columns > 65_536:
            raise InputError(f"force model has {self.rows * self.columns} patches; 65536 at most")
        lengths = {
            "patch_scale_n": 3, "target_scale": len(TARGETS), "sigma_factor": len(TARGETS),
            "most": 4, "distance_limits": 3,
        }  # fmt: skip
        for name, count in lengths.items():
            values = getattr(self, name)
            if len(values) != count or not all(value > 0 for value in values):
                raise InputError(f"force model {name} needs {count} positive numbers")
        self._check_scales()
        if not (
            0 < self.young_modulus_pa < math.inf
            and 0 <= self.stiffness_relative < 10
            and 0 < self.marker_reach_mm < 1e3
        ):
            raise InputError(
                "force model young_modulus_pa and marker_reach_mm must be positive, "
                "stiffness_relative must lie in 0..10"
            )

    def _check_scales(self) -> None:
        """Spreads and largest values that a gel's forces can have."""
        forces, moments, area = self.target_scale[:3], self.target_scale[3:6], self.target_scale[6:]
        for name, values, most in (
            ("target_scale of forces [N]", forces, 200.0),
            ("target_scale of moments [N mm]", moments, 1e4),
            ("target_scale of areas [mm2]", area, 1e4),
            ("patch_scale_n", self.patch_scale_n, 200.0),
            ("sigma_factor", self.sigma_factor, 100.0),
        ):
            if not all(1e-6 * most <= value <= most for value in values):
                raise InputError(
                    f"force model {name} must lie in {1e-6 * most:g}..{most:g}, got {list(values)}"
                )
        for what, spread, most in (
            ("force along z", self.target_scale[2], self.most[0]),
            ("area", self.target_scale[6], self.most[2]),
        ):
            if math.isfinite(most) and most > 1e3 * spread:
                raise InputError(
                    f"force model: the largest {what} of the training, {most:g}, is more than 1000 "
                    f"times its spread, {spread:g}"
                )

    @property
    def input_px(self) -> tuple[int, int]:
        """Height and width of the picture that the network sees."""
        return self.rows * self.patch_px, self.columns * self.patch_px

    def to_dict(self) -> dict[str, Any]:
        """Flat dict of numbers and lists, as a profile's ``architecture`` stores it."""
        return settings_dict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> ForceModelConfig:
        """Inverse of ``to_dict``; unknown and missing keys raise InputError."""
        whole = ("width_px", "height_px", "columns", "rows", "patch_px", "blocks", "hidden")
        with reading_settings("force model", cls.__dataclass_fields__, values):
            read: dict[str, Any] = {name: int(values[name]) for name in whole}
            for name in ("marker_reach_mm", "young_modulus_pa", "stiffness_relative"):
                read[name] = float(values[name])
            for name in (
                "patch_scale_n", "target_scale", "sigma_factor", "most", "distance_limits",
            ):  # fmt: skip
                read[name] = tuple(float(value) for value in values[name])
            # Older blocks know no limits of a patch's force and of colours.
            for name, count in (("most", 4), ("distance_limits", 3)):
                read[name] += (math.inf,) * max(0, count - len(read[name]))
            return cls(
                **read,
                markers=bool(values["markers"]),
                widths=tuple(int(width) for width in values["widths"]),
            )
