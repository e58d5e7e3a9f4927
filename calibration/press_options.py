# SPDX-License-Identifier: Apache-2.0
"""What can be chosen of the fits to ball presses, and the settings of their networks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from taccel_lab.errors import InputError
from taccel_lab.guards import require_range, require_seed
from taccel_lab.networks.color_settings import INPUT_NAMES
from taccel_lab.networks.settings import MAX_BANDS

UNTOUCHED_RADII = 2.5
"""Contact radii from a contact's centre beyond which the gel is at rest, as far as colour tells."""

ThicknessMode = Literal["auto", "fit"]
"""``auto`` keeps a thickness that somebody measured; ``fit`` fits it whatever is stated."""
DISC_RADII = 1.3
"""Contact radii within which the colours of a contact and its rim lie."""
MOST_SYNTHETIC = 10_000
"""Synthetic presses; each takes a tenth of a second."""
RIM_RADII = 0.98
"""Contact radii within which a pixel lies in the contact, as well as circles are known."""
SINK_IN_RADII = 1.03
"""Contact radii beyond which it surely lies outside."""


@dataclass(frozen=True, kw_only=True)
class BallPressOptions:
    """Which presses are held out, and in which circles the others are fitted."""

    holdout_every: int = 4
    """One press in this many is held out to score the result, chosen by position and by the hash
    of the names; 0 holds none out. [split] in captures.toml takes precedence."""
    circles: Literal["fused", "labels", "detected"] = "fused"
    """Contact circles of the others: those given, those found in the images, or the better estimate
    from both. A press without a given circle takes the one found. Held-out presses take no part:
    their given circles alone place them for the figures."""
    thickness: ThicknessMode = "auto"
    """Thickness of the gel: auto fits an unmeasured one to the sink-in around the balls and
    their depth_mm, and rejects a stated one that they contradict. fit always fits it."""


@dataclass(frozen=True, kw_only=True)
class NetworkTraining:
    """Options of the fit of networks."""

    position_bands: int = 0
    """Bands of the positional encoding: sines and cosines of the pixel's position, for light
    that changes within parts of the image. 0 to 8; 0 gives the network the position alone."""
    seed: int = 0
    """Seed of the pixel draw, the initial weights and the batches."""


def _require_settings(
    options: ColorFitOptions | InverseFitOptions, model: str, counts: Sequence[str], fastest: float
) -> None:
    for name in counts:
        option = f"--{name.replace('_', '-')}"
        require_range(option, getattr(options, name), 1, math.inf)
    _require_between("learning_rate", options.learning_rate, fastest)
    require_range(f"--position-bands of the {model}", options.position_bands, 0, MAX_BANDS)
    require_seed(options.seed)


def _require_between(name: str, value: float, below: float) -> None:
    if not 0 < value < below:
        raise InputError(f"{name} must lie in (0, {below:g}), got {value:g}")


@dataclass(frozen=True, kw_only=True)
class ColorTraining(NetworkTraining):
    """Options of the fit of a colour model."""

    steps: int = 400
    """Optimiser steps of the fit."""
    batch_pixels: int = 1024
    """Batch size in pixels; it sets the time of a fit."""


@dataclass(frozen=True, kw_only=True)
class ColorOptions(ColorTraining, BallPressOptions):
    """Settings of ``calibrate_color``."""

    cache: bool = True
    """Whether to use the user's cache folder for contacts."""
    table: bool = True
    """Whether to fit Taxim's table too. The report shows its figures; polycalib.npz beside it is
    for `taccel-lab export --to taxim --table`."""


@dataclass(frozen=True, kw_only=True)
class ColorFitOptions(ColorTraining):
    """Settings of one fit; the defaults take some seconds on one CPU thread."""

    inputs: tuple[str, ...] = INPUT_NAMES
    hidden: tuple[int, ...] = (64, 64, 64)
    learning_rate: float = 2e-2
    huber_levels: float = 2.0
    """Error from which on the loss grows linearly, as images are scored [levels]."""
    disc_pixels: int = 6000
    """Pixels drawn per frame within 1.3 contact radii."""
    ring_pixels: int = 4000
    """Pixels drawn per frame between 1.3 and 2.5 contact radii."""
    far_pixels: int = 1500
    """Pixels drawn per frame beyond 2.5 contact radii."""

    def __post_init__(self) -> None:
        counts = ("steps", "batch_pixels", "disc_pixels", "ring_pixels", "far_pixels")
        _require_settings(self, "color model", counts, 1e3)
        _require_between("huber_levels", self.huber_levels, 1e3)

    @property
    def rings(self) -> tuple[tuple[float, float, int], ...]:
        """Contact radii between which pixels of a frame are drawn, and how many."""
        return (
            (0.0, DISC_RADII, self.disc_pixels),
            (DISC_RADII, UNTOUCHED_RADII, self.ring_pixels),
            (UNTOUCHED_RADII, math.inf, self.far_pixels),
        )


@dataclass(frozen=True, kw_only=True)
class NormalTraining(NetworkTraining):
    """Options of the fit of the networks from colour to slope."""

    synthetic_presses: int = 160
    """Synthetic presses of other tools in the training, besides the captured balls. Without them
    (0) edges and walls read much too flat."""
    steps: int = 500
    """Optimiser steps; each network keeps its best ones."""


@dataclass(frozen=True, kw_only=True)
class NormalOptions(NormalTraining, BallPressOptions):
    """Settings of ``calibrate_normals``."""


@dataclass(frozen=True, kw_only=True)
class InverseFitOptions(NormalTraining):
    """Settings of the networks and their fit."""

    members: int = 4
    hidden: tuple[int, ...] = (64, 64, 64)
    batch_pixels: int = 1024
    """Pixels a member sees in a step."""
    learning_rate: float = 3e-2
    disc_pixels: int = 3000
    """Pixels drawn of each press within the contact."""
    sink_in_pixels: int = 1500
    """Pixels between the contact and the resting face."""
    flat_pixels: int = 700
    """Where the gel is at rest."""
    zooms: int = 3
    """Zooms at which each press is seen; the first is 1."""
    synthetic_pixels: int = 4000
    """Pixels drawn of each synthetic press."""
    synthetic_share: float = 0.6
    """Share of synthetic presses in each batch."""

    def __post_init__(self) -> None:
        counts = ("members", "steps", "batch_pixels", "disc_pixels", "flat_pixels", "zooms")
        _require_settings(self, "normal model", counts, 1.0)
        require_range("synthetic_presses", self.synthetic_presses, 0, MOST_SYNTHETIC)

    @property
    def rings(self) -> tuple[tuple[float, float, int], ...]:
        """Contact radii between which pixels of a press are drawn, and how many."""
        return (
            (0.0, RIM_RADII, self.disc_pixels),
            (SINK_IN_RADII, UNTOUCHED_RADII, self.sink_in_pixels),
            (UNTOUCHED_RADII, math.inf, self.flat_pixels),
        )


@dataclass(frozen=True, kw_only=True)
class DepthOptions:
    """Settings of ``calibrate_depth``."""

    maps: Path | None = None
    """Rectification maps (.npz) that `taccel-lab calibrate camera --maps` wrote: background and
    presses are rectified first, and the scale is that of the maps."""
    channel: Literal["grey", "red", "green", "blue"] = "grey"
    """Channel whose drop is read; grey is the luma of red, green and blue."""
    zero: Literal["auto", "travel", "untouched", "rim"] = "auto"
    """Zero of the depths. By travel, the untouched face by the depth_mm of presses (auto, if
    there is one). By untouched, where the grey is that of untouched gel (auto otherwise). By
    rim, the rim of the contact."""
    circles: Literal["auto", "detected"] = "auto"
    """Contact circles: those given, and found where none is given; or all of them found."""
    seed: int = 0
    """Seed of the resampling that gives the curve's uncertainty."""

    def __post_init__(self) -> None:
        require_seed(self.seed)
