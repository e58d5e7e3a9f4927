# SPDX-License-Identifier: Apache-2.0
"""What can be chosen of the presses that colours and normals are fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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
