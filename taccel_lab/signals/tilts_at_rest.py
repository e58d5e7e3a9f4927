# SPDX-License-Identifier: Apache-2.0
"""What networks from colours to normals give where nothing has changed.

It is taken off what they give for an image, and is the same for all images of a sensor: each place
is asked for once, also by readers that are made anew for every image.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.signals.block_reading import HALVINGS

if TYPE_CHECKING:
    import torch


class TiltsAtRest:
    """What the members of a model give for unchanged places, each asked for once."""

    def __init__(self, config: NormalModelConfig, halvings: int, device: str) -> None:
        import torch

        size = 2**halvings
        count = -(-config.height_px // size) * -(-config.width_px // size)
        self._tilts = torch.zeros((config.members, count, 2), device=device)
        self._asked = torch.zeros(count, dtype=torch.bool, device=device)

    def at(
        self,
        places: torch.Tensor,
        features: torch.Tensor,
        ask: Callable[[torch.Tensor], torch.Tensor],
    ) -> torch.Tensor:
        """Tilts of places [n], shape [member, n, 2]; ``ask`` gives those of features [feature, n],
        which belong to the places."""
        new = (~self._asked[places]).nonzero()[:, 0]
        if len(new):
            self._tilts[:, places[new]] = ask(features.index_select(1, new))
            self._asked[places[new]] = True
        return self._tilts.index_select(1, places)


@lru_cache(maxsize=4)
def tilts_at_rest(
    config: NormalModelConfig, weights_sha256: bytes, device: str
) -> tuple[TiltsAtRest, ...]:
    """Tilts at rest of a model, by pixels and by blocks, kept from one reader of a profile to the
    next."""
    return tuple(TiltsAtRest(config, halvings, device) for halvings in range(HALVINGS + 1))
