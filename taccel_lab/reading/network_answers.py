# SPDX-License-Identifier: Apache-2.0
"""What the networks of a profile answer of blocks of pixels.

A network maps the features of a pixel (``image_features``) to a tilt, of which what it gives for
no change of colour at the same pixel is subtracted. Members of an ensemble give it as their mean,
with the logarithm of the angle by which each expects to be wrong, joined with their disagreement.
A small network that learnt to answer as they do, at a quarter of the work, reads first
(``small_network``); they read what that one is not sure of.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.networks.normal_settings import NormalModelConfig, ensemble_of, small_of
from taccel_lab.reading.blocks import tilts_at_rest
from taccel_lab.reading.features import Blocks
from taccel_lab.reading.room import room
from taccel_lab.reading.small_network import SmallAnswer, left_to_ensemble
from taccel_lab.signals.tensors import layer_tensors, tensor_of

if TYPE_CHECKING:
    import torch

    from taccel_lab.reading.fixed_network import FixedNetwork

Layers = list[tuple["torch.Tensor", "torch.Tensor"]]
"""Weight [member, outputs, inputs] and bias [member, outputs] of each."""
MIN_ERROR_RAD = math.radians(0.02)
CHUNK_PIXELS = {"cpu": 512}
"""Pixels read at once: what the layers give for them stays in a core's cache, which takes half the
time of chunks that do not. Always as many, as products of other sizes may round otherwise."""
DEVICE_CHUNK_PIXELS = 1 << 15
"""Likewise elsewhere, where few large products are fast; 30 MB a layer."""
FEW_PIXELS = {"cpu": 128}
DEVICE_FEW_PIXELS = 1 << 11
"""The same for an ensemble that reads what a small network leaves to it: an eighth more time for
many pixels, but a quarter of it for one."""
SMALL_PIXELS = {"cpu": 256}
"""Likewise for the small network, whose layers take features as they lie."""
MOST_FIXED = 64
"""Widest hidden layer that ``fixed_network`` takes."""


class Networks:
    """Networks of a profile on a device."""

    def __init__(
        self, config: NormalModelConfig, weights: Mapping[str, np.ndarray], device: str
    ) -> None:
        self.config, self.device, self._weights = config, device, weights

    def answer(
        self, blocks: Blocks, picked: torch.Tensor | None, left_out: int | None
    ) -> torch.Tensor:
        """Tilt [rad] and expected angle of error [rad] of blocks, shape [3, n] (``Answer``);
        ``left_out`` as of ``NormalModel.predict``."""
        import torch

        features = blocks.features(picked)
        if picked is None:
            picked = torch.arange(features.shape[1], device=features.device)
        if not self.config.small_hidden or left_out is not None:
            return self._by_ensemble(blocks, picked, features, left_out)
        still = self._resting(blocks, picked, features, small=True)
        said = SmallAnswer.of(self._outputs(features, small=True)[0], still[0])
        count = features.shape[1]
        # What is picked past the last one goes to one more place, which nobody reads.
        found = said.tilt_rad.new_empty((3, count + 1))
        found[:2, :count], found[2, :count] = said.tilt_rad.T, said.expected_rad
        left = _places_of(left_to_ensemble(said.error_rad, said.off_rad), blocks.block_px)
        if len(left):
            of = left.clamp(max=count - 1)
            few = features.index_select(1, of)
            found.index_copy_(1, left, self._by_ensemble(blocks, picked[of], few, None))
        return found[:, :count]

    def answer_pixels(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Tilt [rad] [n, 2] and expected angle of error [rad] [n] that the ensemble gives for raw
        features [feature, n]."""
        return self._judged(self._outputs(features), self._still(features), None)

    @cached_property
    def _layers(self) -> Layers:
        """Layers of the ensemble."""
        return self._of_raw_features(ensemble_of(self._weights))

    @cached_property
    def _small_layers(self) -> Layers:
        """Layers of the small network, an ensemble of one."""
        small = {name: values[None] for name, values in small_of(self._weights).items()}
        return self._of_raw_features(small)

    @cached_property
    def _fixed(self) -> FixedNetwork:
        """Layers of the ensemble in one kernel, for readings of fixed sizes."""
        from taccel_lab.reading.fixed_network import FixedNetwork

        return FixedNetwork(self._layers)

    @cached_property
    def _fixed_small(self) -> FixedNetwork:
        """The same of the small network."""
        from taccel_lab.reading.fixed_network import FixedNetwork

        return FixedNetwork(self._small_layers)

    def _of_raw_features(self, weights: Mapping[str, np.ndarray]) -> Layers:
        """Layers of weights with members, for raw features: the first one normalises them, too."""
        layers = layer_tensors(weights)
        weight, bias = (values.double() for values in layers[0])
        mean, scale = (
            tensor_of(np.array(values))
            for values in (self.config.input_mean, self.config.input_scale)
        )
        first = weight / scale
        layers[0] = first.float(), (bias - first @ mean).float()
        return [(w.to(self.device), b.to(self.device)) for w, b in layers]

    @cached_property
    def _alone(self) -> NormalModelConfig:
        """Settings of an ensemble of one."""
        return replace(self.config, members=1)

    @cached_property
    def _digest(self) -> bytes:
        weights = b"".join(self._weights[name].tobytes() for name in self._weights)
        return hashlib.sha256(weights).digest()

    def _by_ensemble(
        self, blocks: Blocks, picked: torch.Tensor, features: torch.Tensor, left_out: int | None
    ) -> torch.Tensor:
        """What ``answer`` gives, by the ensemble or by one of its members."""
        import torch

        still = self._resting(blocks, picked, features)
        tilt, error = self._judged(self._outputs(features), still, left_out)
        return torch.cat([tilt.T, error[None]])

    def _resting(
        self, blocks: Blocks, picked: torch.Tensor, features: torch.Tensor, *, small: bool = False
    ) -> torch.Tensor:
        """What each member, or the small network, gives without a change for features [feature, n]
        of blocks, shape [member, n, 2]."""
        if self.config.background:
            return self._still(features, small=small)
        _, height, width = blocks.shape
        row, column = (picked % (height * width)) // width, picked % width
        columns = -(-self.config.width_px // blocks.block_px)
        place = (blocks.rows.start + row) * columns + blocks.columns.start + column
        config, ask = self._alone if small else self.config, partial(self._still, small=small)
        at_rest = tilts_at_rest(config, self._digest, blocks.block_px, self.device)
        if room() is not None:
            at_rest.of_all(blocks.known, self.config.varying_count, ask)
        return at_rest.at(place, features, ask)

    def _still(self, features: torch.Tensor, *, small: bool = False) -> torch.Tensor:
        """``_resting`` of features [feature, n], asked for now."""
        still = features.clone()
        still[: self.config.varying_count] = 0.0
        return self._outputs(still, small=small)[..., :2]

    def _outputs(self, features: torch.Tensor, *, small: bool = False) -> torch.Tensor:
        """What each member gives for raw features [feature, n], shape [member, n, 3]; ``small``:
        the small network, shape [1, n, 4]."""
        import torch

        layers = self._small_layers if small else self._layers
        hidden = [len(bias[0]) for _, bias in layers[:-1]]
        here = room()
        if here is not None and 0 < max(hidden, default=0) <= MOST_FIXED:
            return (self._fixed_small if small else self._fixed)(features, here.counted)
        chunk, elsewhere = CHUNK_PIXELS, DEVICE_CHUNK_PIXELS
        if small:
            chunk = SMALL_PIXELS
        elif self.config.small_hidden:
            chunk, elsewhere = FEW_PIXELS, DEVICE_FEW_PIXELS
        size, count = chunk.get(features.device.type, elsewhere), features.shape[1]
        *whole, last = features.split(size, dim=1)
        last = torch.nn.functional.pad(last, (0, -count % size))
        if small:
            columns = [_of_columns(layers, part) for part in (*whole, last)]
            return torch.cat(columns, dim=1)[:, :count].T[None]
        members = len(layers[0][0])
        parts = [network(layers, part.T.expand(members, -1, -1)) for part in (*whole, last)]
        return torch.cat(parts, dim=1)[:, :count]

    def _judged(
        self, outputs: torch.Tensor, still: torch.Tensor, left_out: int | None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Tilt [rad] [n, 2] and expected angle of error [rad] [n] of what members give, [member, n,
        3], now and at rest; ``left_out`` as in ``predict``."""
        import torch

        if room() is not None:
            from taccel_lab.reading.fixed_network import judged

            factor = self.config.error_factor
            found = judged(outputs, still, left_out, factor, MIN_ERROR_RAD)
            return found[:2].T, found[2]
        tilts, errors = outputs[..., :2] - still, expected_error(outputs)
        others = reading = tilts
        if left_out is not None:
            others = torch.cat([tilts[:left_out], tilts[left_out + 1 :]])
            reading, errors = (values[left_out : left_out + 1] for values in (tilts, errors))
        spread2 = (others - others.mean(dim=0)).square().sum(dim=-1).mean(dim=0)
        own = self.config.error_factor * errors.mean(dim=0)
        return reading.mean(dim=0), (own.square() + spread2).sqrt()


def _places_of(flags: torch.Tensor, block_px: int) -> torch.Tensor:
    """Places of flags [n] that are set, and as many past the last one as a ``Room`` has more."""
    import torch

    here = room()
    if here is None:
        return flags.nonzero()[:, 0]
    count = len(flags)
    if here.counted is not None:
        flags = flags & (torch.arange(count, device=flags.device) < here.counted)
    here.counted = flags.sum()
    size = here.size(f"blocks of {block_px} px left to the ensemble", here.counted, count)
    return torch.nonzero_static(flags, size=size, fill_value=count)[:, 0]


def network(
    layers: Sequence[tuple[torch.Tensor, torch.Tensor]], inputs: torch.Tensor
) -> torch.Tensor:
    """Raw outputs [member, n, 3] of network inputs [member, n, feature]; differentiable."""
    import torch

    values = inputs
    for i, (weight, bias) in enumerate(layers):
        if i:
            values = torch.nn.functional.silu(values)
        values = torch.baddbmm(bias[:, None, :], values, weight.transpose(1, 2))
    return values


def expected_error(outputs: torch.Tensor) -> torch.Tensor:
    """Expected angle of error [rad] [member, n] of raw outputs [member, n, 3]."""
    return outputs[..., 2].clamp(-12.0, 2.0).exp() + MIN_ERROR_RAD


def _of_columns(layers: Layers, inputs: torch.Tensor) -> torch.Tensor:
    """``network`` of one member, of inputs [feature, n], shape [output, n]; inputs that lie so need
    no turning."""
    import torch

    values = inputs
    for i, (weight, bias) in enumerate(layers):
        if i:
            torch.nn.functional.silu(values, inplace=True)
        values = torch.addmm(bias[0, :, None], weight[0], values)
    return values


def tilt_and_error(
    layers: Sequence[tuple[torch.Tensor, torch.Tensor]],
    inputs: torch.Tensor,
    still: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Tilt [rad] [member, n, 2] and expected error [rad] [member, n] of network inputs.

    ``inputs`` and ``still`` (the same pixels without change) have shape [member, n, feature];
    differentiable.
    """
    import torch

    both = network(layers, torch.cat([inputs, still], dim=1))
    count = inputs.shape[1]
    return both[:, :count, :2] - both[:, count:, :2], expected_error(both[:, :count])
