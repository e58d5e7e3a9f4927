# SPDX-License-Identifier: Apache-2.0
"""Settings of force models (``force_model``): sizes, scales, limits, as a profile stores them.

Whether a model answers forces that a press can have is judged here, too: the layers by which
``signals.force_network`` reads images see a few made-up changes of colour, in numpy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.guards import require_range
from taccel_lab.networks.settings import ACTIVATIONS, NetworkSettings

TARGETS = ("fx_n", "fy_n", "fz_n", "tx_nmm", "ty_nmm", "tz_nmm", "area_mm2")
"""What has a standard deviation, in order: force, moment about the gel's origin, area."""
LEVELS = 32.0
"""Change of colour that counts as one in the network [levels of 255]."""
STATISTICS = 13
"""Statistics of the change of colour: by channel mean, logarithms of the standard deviation and of
that of the Laplacian; correlations of channels; logarithm of the largest change."""
MARKER_PLANES = 3
"""Motion along x and y, and how many markers tell it."""
MARKER_UNIT_MM = 0.2
"""Motion of markers that counts as one in the network."""
LOG_SIGMA = (-7.0, 3.0)
"""Logarithms of standard deviations, over the spread of the training, are kept in this range."""
STD_FLOOR = 0.25
"""Levels that are added to a standard deviation before its logarithm is taken."""


@dataclass(frozen=True)
class ForceModelConfig(NetworkSettings):
    """Everything besides the weights that is needed to rebuild a ``ForceModel``."""

    model: ClassVar[str] = "force model"

    width_px: int
    """Width of the camera's images."""
    height_px: int
    columns: int
    """Number of patches, side by side over the image."""
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
    """Modulus of the gel that forces are predicted for."""
    stiffness_relative: float = 0.0
    """Standard deviation of a unit's modulus, as a part of it."""
    most: tuple[float, ...] = (math.inf,) * 4
    """Largest force along z [N], force along the face [N], area [mm2] and force of a patch along z
    [N] of the training."""
    distance_limits: tuple[float, ...] = (math.inf,) * 3
    """Limits from which an image is outside: Mahalanobis distances of features and of statistics,
    and ``color_reach`` over the training's largest."""

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
        if not 0 < self.young_modulus_pa < math.inf:
            raise InputError("force model young_modulus_pa must be positive")
        require_range("force model stiffness_relative", self.stiffness_relative, 0.0, 10.0)
        require_range("force model marker_reach_mm", self.marker_reach_mm, 0.01, 100.0)
        require_range("force model sigma_factor", self.sigma_factor, 0.02, 50.0)
        limits = [limit for limit in self.distance_limits if limit < math.inf]
        require_range("force model distance_limits", limits, 0.05, 300.0)

    def _check_scales(self) -> None:
        """Spreads and largest values that a gel's forces can have, and that belong together."""
        forces, moments, area = self.target_scale[:3], self.target_scale[3:6], self.target_scale[6]
        for name, values, low, high in (
            ("target_scale of forces [N]", forces, 2e-4, 200.0),
            ("target_scale of moments [N mm]", moments, 0.01 * max(forces), 200.0 * max(forces)),
            ("target_scale of the area [mm2]", (area,), 0.01, 1e4),
        ):
            require_range(f"force model {name}", values, low, high)
        patches = 10 * self.rows * self.columns
        for k, axis in enumerate("xyz"):
            name = f"patch_scale_n of {axis}"
            patch_n = self.patch_scale_n[k]
            require_range(f"force model {name}", patch_n, forces[k] / patches, 10 * forces[k])
        for name, spread, most in (
            ("force along z", forces[2], self.most[0]),
            ("force along the face", min(forces[:2]), self.most[1]),
            ("area", area, self.most[2]),
            ("force of a patch", self.patch_scale_n[2], self.most[3]),
        ):
            if math.isfinite(most):
                name = f"largest {name} of the training"
                require_range(f"force model {name}", most, 0.1 * spread, 500.0 * spread)

    @property
    def input_px(self) -> tuple[int, int]:
        """Height and width of the picture that the network sees."""
        return self.rows * self.patch_px, self.columns * self.patch_px

    def weight_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of all arrays by name."""
        shapes: dict[str, tuple[int, ...]] = {}

        def layer(name: str, outputs: int, inputs: int, kernel: tuple[int, ...]) -> None:
            shapes[f"{name}.weight"] = (outputs, inputs, *kernel)
            shapes[f"{name}.bias"] = (outputs,)

        inputs = 5  # colours and place
        for k, width in enumerate(self.widths):
            layer(f"down{k}", width, inputs, (3, 3))
            inputs = width
        last = self.widths[-1]
        for k in range(self.blocks):
            more = MARKER_PLANES if self.markers and k == 0 else 0
            layer(f"block{k}", last, last + more, (3, 3))
        layer("patch", 4, last, (1, 1))
        layer("hidden", self.hidden, 2 * last, ())
        layer("rest", 3 + len(TARGETS), self.hidden, ())
        for name, count in (("features", self.hidden), ("statistics", STATISTICS)):
            shapes[f"{name}.mean"] = (count,)
            shapes[f"{name}.whiten"] = (count, count)
        shapes["colors.most"] = (len(color_directions()),)
        return shapes

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Settings of a block; older ones know no limits of a patch's force and of colours."""
        values = dict(values)
        for name, count in (("most", 4), ("distance_limits", 3)):
            if isinstance(known := values.get(name), (list, tuple)):
                values[name] = [*known, *[math.inf] * (count - len(known))]
        return super().from_dict(values)


def color_directions() -> np.ndarray:
    """Changes of colour that ``color_reach`` goes along: single channels, sums and differences of
    two and of three, unit vectors of RGB, float32, [26, 3]."""
    directions = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    directions = directions[np.abs(directions).sum(axis=1) > 0]
    return (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)


def with_color_limits(weights: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Weights of a block; an older one has no limit of colours, and gets one level for each."""
    return {"colors.most": np.ones(len(color_directions()), np.float32), **weights}


MOST_FORCE_N = 1000.0
"""No gel of a tactile sensor is pressed harder."""
BEYOND = 30.0
"""Times the largest force of the training: what a network may answer to images that are none."""
_DENT_LEVELS = 16.0
"""Change of colour in the made-up dents, where the training reached so far."""


def require_forces(config: ForceModelConfig, weights: Mapping[str, np.ndarray]) -> None:
    """Refuse a network that answers to faint dents, or to none, what no press has."""
    with np.errstate(over="ignore", invalid="ignore"):
        forces = patch_forces(config, weights, _dents(config, weights["colors.most"]))
        answers = np.abs(forces.sum(axis=(-2, -1)))
    answers = np.where(np.isfinite(answers), answers, np.inf)
    most_n = min(BEYOND * max(config.most[:2]), MOST_FORCE_N)
    if not answers.max() <= most_n:
        raise InputError(
            f"the force model answers {answers.max():.3g} N to a faint dent; at most "
            f"{most_n:.3g} N are possible, {BEYOND:g} times the most of its training or 1000: its "
            "weights or its settings are those of another network, or scaled"
        )


def _dents(config: ForceModelConfig, reach: np.ndarray) -> np.ndarray:
    """Changes of colour over ``LEVELS``: none, and a round dent that is darker, brighter, or of
    another colour at either side, [4, 3, height, width]."""
    height, width = config.input_px
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    dent = np.exp(-8 * (x**2 + y**2))
    lean = x * dent
    level = min(_DENT_LEVELS, float(reach.min())) / LEVELS
    none = np.zeros_like(dent)
    return level * np.stack([[none] * 3, [-dent] * 3, [dent] * 3, [lean, none, -lean]])


def patch_forces(
    config: ForceModelConfig, weights: Mapping[str, np.ndarray], change: np.ndarray
) -> np.ndarray:
    """Forces of the patches at the modulus of the training [N], [n, 3, row, column]; markers that
    are seen rest."""
    silu = ACTIVATIONS["silu"]
    count, _, height, width = change.shape
    place = np.stack(
        np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")[::-1]
    )
    x = np.concatenate([change, np.broadcast_to(place, (count, *place.shape))], axis=1)
    x = x.astype(np.float32)
    for k in range(len(config.widths)):
        x = silu(_convolved(x, weights[f"down{k}.weight"], weights[f"down{k}.bias"], 2))
    for k in range(config.blocks):
        seen = x
        if config.markers and k == 0:
            rest = np.zeros((count, 3, *x.shape[2:]), dtype=np.float32)
            rest[:, 2] = 1.0
            seen = np.concatenate([x, rest], axis=1)
        x = x + silu(_convolved(seen, weights[f"block{k}.weight"], weights[f"block{k}.bias"], 1))
    patch = np.tensordot(weights["patch.weight"][:3, :, 0, 0], x, ([1], [1])).swapaxes(0, 1)
    scale = np.array(config.patch_scale_n)[:, None, None]
    return (patch + weights["patch.bias"][:3, None, None]) * scale


def _convolved(x: np.ndarray, weight: np.ndarray, bias: np.ndarray, stride: int) -> np.ndarray:
    """3 x 3 convolution of images [n, channel, height, width] with a border of zeros."""
    padded = np.pad(x, ((0, 0), (0, 0), (1, 1), (1, 1)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(2, 3))
    windows = windows[:, :, ::stride, ::stride]
    found = np.tensordot(weight, windows, ([1, 2, 3], [1, 4, 5]))
    return found.swapaxes(0, 1) + bias[:, None, None]
