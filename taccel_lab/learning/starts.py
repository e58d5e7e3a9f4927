# SPDX-License-Identifier: Apache-2.0
"""What episodes draw: starts, and parameters of bodies; on the device, reproducible by seed.

An environment's draws depend on its own seed and on how many episodes it has begun, and neither on
the others nor on the device: numbers are hashed from these, not taken from a stream.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
import warp as wp

from taccel_lab.model import Model

if TYPE_CHECKING:
    from taccel_lab.learning.ranges import DrawnRange

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _draw_kernel(
    seeds: wp.array(dtype=wp.int32),
    episodes: wp.array(dtype=wp.int32),
    draws: wp.array2d(dtype=wp.float64),
):
    env = wp.tid()
    state = wp.rand_init(seeds[env], episodes[env])
    for k in range(draws.shape[1]):
        draws[env, k] = wp.float64(wp.randf(state))


class EpisodeDraws:
    """Numbers of the episodes of a vector environment."""

    def __init__(self, model: Model, per_episode: int) -> None:
        """``per_episode``: numbers that each episode draws."""
        count, self._device = model.env_count, model.device
        self._seeds = wp.zeros(count, dtype=wp.int32, device=self._device)
        self._episodes = wp.zeros(count, dtype=wp.int32, device=self._device)
        self._draws = wp.zeros((count, per_episode), dtype=wp.float64, device=self._device)

    def seed(self, first: int, who: torch.Tensor) -> None:
        """Environment i of ``who`` (bool, [env]) goes by seed ``first + i`` from now on, and is at
        its first episode again."""
        seeds = wp.to_torch(self._seeds)
        own = first + torch.arange(len(seeds), dtype=torch.int64, device=seeds.device)
        seeds.copy_(torch.where(who, own.to(torch.int32), seeds))
        wp.to_torch(self._episodes).masked_fill_(who, 0)

    def begin(self, who: torch.Tensor) -> torch.Tensor:
        """Numbers in [0, 1) of the next episode of each environment, float64, [env, per_episode];
        that of ``who`` (bool, [env]) begins, and the others will draw theirs again."""
        wp.launch(
            _draw_kernel,
            dim=len(self._seeds),
            inputs=[self._seeds, self._episodes],
            outputs=[self._draws],
            device=self._device,
        )
        wp.to_torch(self._episodes).add_(who)
        return wp.to_torch(self._draws).clone()


def randomise(
    model: Model, ranges: Sequence[DrawnRange], unit: torch.Tensor, who: torch.Tensor
) -> None:
    """Set parameters of bodies in the environments of ``who`` (bool, [env]): the k-th by the k-th
    number of each environment in [0, 1), float64, [env, ranges]."""
    for k, item in enumerate(ranges):
        value = (item.low + (item.high - item.low) * unit[:, k]).contiguous()
        for names in item.of:
            if item.what == "friction":
                model.set_friction(names[0], names[1], value, mask=who)
            else:
                model.set_body(names[0], **{item.what: value}, mask=who)
