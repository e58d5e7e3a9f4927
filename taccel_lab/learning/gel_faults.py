# SPDX-License-Identifier: Apache-2.0
"""Faults of what the cameras of gels show in a vector environment, drawn by seed and episode."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.learning.gel_views import GelViews
from taccel_lab.outputs import to_torch
from taccel_lab.signals.faulty_frames import FaultyFrames
from taccel_lab.signals.frame_faults import FrameFaults
from taccel_lab.state import State

IMAGES = ("rgb", "rgb_levels")
"""Observations that are a camera's frames."""


class GelFaults:
    """Frames of the gels' cameras; a frame is what a step led to, however often it is read."""

    def __init__(
        self, faults: FrameFaults, views: GelViews, observed: Sequence[str], env_count: int
    ) -> None:
        """``faults``: what can be wrong; ``views``: of the gels; ``observed``: what is read of
        them.

        Raises InputError where faults can be, but no image is read.
        """
        self._views = views
        self.names = tuple(name for name in observed if name in IMAGES) if faults else ()
        """Observations whose frames can be faulty."""
        if faults and not self.names:
            raise InputError(f"faults are of images: observe {' or '.join(IMAGES)}")
        size = (views.grids[0].width_px, views.grids[0].height_px)
        self._shape = (env_count, len(views.gels), size[1], size[0], 3)
        count = (env_count, len(views.gels))
        self._frames = {
            name: FaultyFrames(faults, size, *count, device=views.device) for name in self.names
        }

    def read(
        self, name: str, state: State, seeds: wp.array, episodes: wp.array, steps: torch.Tensor
    ) -> torch.Tensor:
        """Frames as of ``GelViews.read``, [env, gel, h, w, 3]; what each environment draws goes by
        its seed, how many episodes it has begun and its steps in this one, int32, [env]."""
        frames = self._frames[name]
        frames.draw(seeds, episodes, wp.from_torch(steps))
        light = frames.faults.of_light
        # Light changes before levels are rounded.
        seen = self._views.read("rgb_levels" if light else name, state).flatten(0, 1)
        if light:
            seen = to_torch(frames.lit(wp.from_torch(seen)))
            if name == "rgb":
                seen = seen.clamp(0, 255).round().to(torch.uint8)
        return to_torch(frames.sent(wp.from_torch(seen))).view(self._shape)

    def kinds(self) -> dict[str, torch.Tensor]:
        """Bits of the faults of the frames that were read last, int32, [env, gel], for ``info``;
        nothing where there cannot be any."""
        if not self.names:
            return {}
        bits = to_torch(self._frames[self.names[0]].kinds)
        return {"frame_faults": bits.view(self._shape[:2]).clone()}
