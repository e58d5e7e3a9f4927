# SPDX-License-Identifier: Apache-2.0
"""Options of all fits to ball presses, and of their networks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from taccel_lab.errors import InputError
from taccel_lab.guards import require_range, require_seed
from taccel_lab.networks.settings import MAX_BANDS

UNTOUCHED_RADII = 2.5
"""Contact radii from a contact's centre beyond which the gel is at rest, as far as colour tells."""

ThicknessMode = Literal["auto", "fit"]
"""``auto`` keeps a thickness that somebody measured; ``fit`` fits it whatever is stated."""


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


def require_settings(
    options: NetworkTraining,
    model: str,
    counts: Sequence[str],
    learning_rate: float,
    fastest: float,
) -> None:
    """Raise InputError for settings of a fit that cannot be; ``counts`` name those that are counts,
    ``fastest`` is what the learning rate lies below."""
    for name in counts:
        option = f"--{name.replace('_', '-')}"
        require_range(option, getattr(options, name), 1, math.inf)
    require_between("learning_rate", learning_rate, fastest)
    require_range(f"--position-bands of the {model}", options.position_bands, 0, MAX_BANDS)
    require_seed(options.seed)


def require_between(name: str, value: float, below: float) -> None:
    """Raise InputError for a value outside of (0, ``below``)."""
    if not 0 < value < below:
        raise InputError(f"{name} must lie in (0, {below:g}), got {value:g}")
