# SPDX-License-Identifier: Apache-2.0
"""Surface normals from a tactile image: a small ensemble of networks, with its own uncertainty.

A network maps the features of a pixel (``normal_features``) to a tilt: the rotation, as a vector of
two angles, that takes the resting normal of that pixel to the present one. What the network gives
for no change of colour at the same pixel is subtracted, so that the background itself reads as the
resting surface, exactly, on curved gels too. Colour and position as inputs are those of
GelSight's calibration by balls (Yuan, Dong and Adelson, Sensors 17(12), 2017) and of gs_sdk's
network; the windows, the ensemble and the uncertainty are additions.

A third output is the logarithm of the angle by which the tilt is expected to be wrong; it is joined
with the disagreement of the ensemble's members.
"""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Generic

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.networks.settings import checked_weights
from taccel_lab.reading.blocks import (
    LARGEST_PX,
    painted,
    read_in_blocks,
    read_in_room,
    tilts_at_rest,
)
from taccel_lab.reading.features import (
    Blocks,
    FeatureWindows,
    color_change,
    pixel_place,
    place_of_blocks,
)
from taccel_lab.reading.room import room
from taccel_lab.signals.normals import rotate_from_z
from taccel_lab.signals.tensors import (
    Array,
    Given,
    as_given,
    layer_tensors,
    length2,
    require_device,
    tensor_of,
)

if TYPE_CHECKING:
    import torch

    from taccel_lab.profile import SensorProfile

MAX_TILT_RAD = math.radians(85.0)
AWAY = 0.25
"""Distance from the part of the image that fitted contacts span, in its shorter sides, at which a
tilt may be off by itself; nearer by, by the square of it. Six presses of a corner read others 0.1
to 0.3 away by 0.3 to 0.6 of their tilts wrong (FOTS), by less where colours are even."""
MIN_ERROR_RAD = math.radians(0.02)
RAYLEIGH_MEAN = math.sqrt(math.pi / 2)
"""Mean length of a vector of two independent normal deviates of unit standard deviation."""
CHUNK_PIXELS = {"cpu": 512}
"""Pixels read at once: what the layers give for them stays in a core's cache, which takes half the
time of chunks that do not. Always as many, as products of other sizes may round otherwise."""
DEVICE_CHUNK_PIXELS = 1 << 15
"""Likewise elsewhere, where few large products are fast; 30 MB a layer."""


MOST_FIXED = 64
"""Widest hidden layer that ``fixed_network`` takes."""


@dataclass(frozen=True)
class NormalMap(Generic[Array]):
    """What the inverse model reads from one image, or from several along leading axes: arrays, or
    tensors of the model's device."""

    normals: Array
    """Outward unit normals, gel frame, shape [..., height_px, width_px, 3]."""
    tilt_rad: Array
    """Rotation of each normal from rest, components along x and y, shape [..., h, w, 2]."""
    sigma_deg: Array
    """Standard deviation of each component of the tilt [degrees], shape [..., h, w]. The angle
    between the given and the true normal is expected to be 1.25 times this."""
    radius95_deg: Array
    """Angle within which the true normal lies in 95 % of a press's pixels [degrees], likewise."""

    def slope_sigma(self) -> Array:
        """Standard deviation of each component of the slope from rest, shape [..., h, w]: an
        angle's error grows with 1 + slope^2 where it becomes one of the slope."""
        import torch

        tilt = length2(tensor_of(self.tilt_rad)).clamp(max=MAX_TILT_RAD)
        sigma = torch.deg2rad(tensor_of(self.sigma_deg)) / tilt.cos().square()
        return as_given(sigma, self.sigma_deg)

    def slopes(self) -> Array:
        """dh/dx and dh/dy of the surface, shape [..., height_px, width_px, 2]."""
        normals = tensor_of(self.normals)
        upright = normals[..., 2:].clamp(min=math.cos(MAX_TILT_RAD))
        return as_given(-normals[..., :2] / upright, self.normals)

    def like(self, given: Given) -> NormalMap[Given]:
        """Map with arrays where ``given`` is one, with tensors otherwise."""
        maps = (self.normals, self.tilt_rad, self.sigma_deg, self.radius95_deg)
        return NormalMap(*(as_given(tensor_of(values), given) for values in maps))


class NormalModel:
    """Normals of tactile images.

    ``weights`` holds float32 arrays ``layer<i>.weight`` [members, outputs, inputs] and
    ``layer<i>.bias`` [members, outputs].
    """

    def __init__(
        self,
        config: NormalModelConfig,
        weights: Mapping[str, np.ndarray],
        device: str = "cpu",
    ) -> None:
        """``device``: of torch, on which images are read, such as cpu or cuda:0."""
        require_device(device)
        self.config, self.device = config, device
        self.weights = checked_weights("normal model", config.weight_shapes(), weights)
        self.recordings: OrderedDict[Hashable, Any] = OrderedDict()
        """What readings on a GPU keep from one to the next (``recorded``)."""

    @classmethod
    def from_profile(cls, profile: SensorProfile, device: str = "cpu") -> NormalModel:
        """The model in a profile's ``normals`` block; raises InputError when it has none."""
        if profile.normals is None or profile.normal_weights is None:
            raise InputError(
                f"the profile of {profile.sensor.name} has no normals block; fit one with "
                "taccel-lab calibrate normals"
            )
        config = NormalModelConfig.from_dict(profile.normals.architecture)
        return cls(config, profile.normal_weights, device)

    @cached_property
    def _layers(self) -> list[tuple[torch.Tensor, torch.Tensor]]:
        """Layers of raw features: the first one normalises them, too."""
        layers = layer_tensors(self.weights)
        weight, bias = (values.double() for values in layers[0])
        mean, scale = (
            tensor_of(np.array(values))
            for values in (self.config.input_mean, self.config.input_scale)
        )
        first = weight / scale
        layers[0] = first.float(), (bias - first @ mean).float()
        return [(w.to(self.device), b.to(self.device)) for w, b in layers]

    def predict(
        self,
        image: Array,
        background: np.ndarray,
        *,
        mask: np.ndarray | None = None,
        rest_normals: np.ndarray | None = None,
        left_out: int | None = None,
        around: np.ndarray | None = None,
        coarse: bool = False,
    ) -> NormalMap[Array]:
        """Normals of whole images: by blocks of pixels where the surface is smooth, and by pixels
        where it is not (``blocks``).

        Args:
            image: RGB levels, shape [..., height_px, width_px, 3]; several images are read at once.
                The maps are tensors of the model's device where it is a tensor.
            background: The untouched sensor under the same light, shape [height_px, width_px, 3].
            mask: Pixels that count, bool, shape [height_px, width_px]. Masked pixels read as rest,
                whatever they hold.
            rest_normals: Outward unit normals of the undeformed face, shape [h, w, 3]; a flat face
                when None.
            left_out: The member that did not see this press when the others did. It reads alone,
                and its own error is no part of what it expects: how far it is off the others would
                tell it, as nothing does on a new press.
            around: Blocks of ``LARGEST_PX`` pixels that smaller ones may be read in, bool, shape
                [ceil(h / LARGEST_PX), ceil(w / LARGEST_PX)]; all when None.
            coarse: Whether blocks of ``LARGEST_PX`` pixels are all that is read; the maps are of
                these.
        """
        import torch

        shape = (self.config.height_px, self.config.width_px, 3)
        for name, size in (("image", image.shape[-3:]), ("background", background.shape)):
            if tuple(size) != shape:
                raise InputError(f"{name} has shape {tuple(size)}, the normal model needs {shape}")
        with torch.no_grad():
            on = torch.empty(0, device=self.device)
            images = tensor_of(image, like=on).reshape(-1, *shape)
            light = tensor_of(background, torch.float32, on)
            kept = None if mask is None else tensor_of(mask, like=on)
            windows = self._windows(color_change(images, light, kept), light, kept)

            def answer(blocks: Blocks, picked: torch.Tensor | None) -> torch.Tensor:
                return self._answer(blocks, picked, left_out)

            near, here = None if around is None else tensor_of(around, like=on), room()
            if coarse:
                seen = windows.blocks if here is None else windows.sparse
                blocks = seen(LARGEST_PX)
                read = answer(blocks, None).unflatten(1, blocks.shape)
            elif here is None:
                read = painted(read_in_blocks(windows, answer, _lean_slopes, near), shape[:2])
            else:
                read = read_in_room(windows, answer, near, here)
            # Lines that go on beyond the outermost blocks may fall below any error there is.
            least = self.config.error_factor * MIN_ERROR_RAD
            tilt, error = read[:2].movedim(0, -1), read[2].clamp(min=least)
            if windows.mask is not None:
                held = windows.cover(LARGEST_PX) > 0 if coarse else windows.mask
                tilt = tilt.where(held[..., None], 0.0)
            lead = image.shape[:-3]
            tilt, error = (
                tilt.reshape(*lead, *tilt.shape[1:]),
                error.reshape(*lead, *error.shape[1:]),
            )
            normals = relative_normals(tilt)
            if rest_normals is not None:
                rest = place_of_blocks(rest_normals, LARGEST_PX if coarse else 1).movedim(0, -1)
                normals = rotate_from_z(normals, tensor_of(rest, tilt.dtype, on))
            sigma_deg = torch.rad2deg(error) / RAYLEIGH_MEAN
            if self.config.presses_px:
                away = _away(self.config, LARGEST_PX if coarse else 1, on.device)
                lean_deg = torch.rad2deg(length2(tilt)).to(sigma_deg.dtype)
                sigma_deg = torch.hypot(sigma_deg, away * lean_deg)
            found = NormalMap(normals, tilt, sigma_deg, self.config.radius95_sigmas * sigma_deg)
        return found.like(image)

    def _windows(
        self, change: torch.Tensor, background: torch.Tensor, mask: torch.Tensor | None
    ) -> FeatureWindows:
        config = self.config

        def place(block_px: int) -> torch.Tensor:
            return _place(
                config.width_px, config.height_px, config.position_bands, block_px, change.device
            )

        return FeatureWindows(
            change,
            config.scales_px,
            config.slope_scales_px,
            place,
            mask=mask,
            background=background if config.background else None,
        )

    def _answer(
        self, blocks: Blocks, picked: torch.Tensor | None, left_out: int | None
    ) -> torch.Tensor:
        """Tilt [rad] and expected angle of error [rad] of blocks, shape [3, n] (``Answer``)."""
        import torch

        features = blocks.features(picked)
        if self.config.background:
            still = self._still(features)
        else:
            _, height, width = blocks.shape
            if picked is None:
                picked = torch.arange(features.shape[1], device=features.device)
            row, column = (picked % (height * width)) // width, picked % width
            columns = -(-self.config.width_px // blocks.block_px)
            place = (blocks.rows.start + row) * columns + blocks.columns.start + column
            at_rest = tilts_at_rest(self.config, self._digest, blocks.block_px, self.device)
            if room() is not None:
                at_rest.of_all(blocks.known, self.config.varying_count, self._still)
            still = at_rest.at(place, features, self._still)
        tilt, error = self._judged(self._outputs(features), still, left_out)
        return torch.cat([tilt.T, error[None]])

    @cached_property
    def _fixed(self) -> Callable[[torch.Tensor], torch.Tensor]:
        """The same layers in one kernel, for readings of fixed sizes."""
        from taccel_lab.reading.fixed_network import FixedNetwork

        return FixedNetwork(self._layers)

    @cached_property
    def _digest(self) -> bytes:
        weights = b"".join(self.weights[name].tobytes() for name in self.weights)
        return hashlib.sha256(weights).digest()

    def _still(self, features: torch.Tensor) -> torch.Tensor:
        """What each member gives without a change, [member, n, 2], for features [feature, n]."""
        return self._outputs(self._at_rest(features))[..., :2]

    def _at_rest(self, features: torch.Tensor) -> torch.Tensor:
        """``NormalModelConfig.at_rest`` of features [feature, n]."""
        still = features.clone()
        still[: self.config.varying_count] = 0.0
        return still

    def _outputs(self, features: torch.Tensor) -> torch.Tensor:
        """What each member gives for raw features [feature, n], shape [member, n, 3]."""
        import torch

        if room() is not None and max(self.config.hidden) <= MOST_FIXED:
            return self._fixed(features)
        chunk = CHUNK_PIXELS.get(features.device.type, DEVICE_CHUNK_PIXELS)
        count = features.shape[1]
        *whole, last = features.split(chunk, dim=1)
        last = torch.nn.functional.pad(last, (0, -count % chunk))
        parts = [
            network(self._layers, part.T.expand(self.config.members, -1, -1))
            for part in (*whole, last)
        ]
        return torch.cat(parts, dim=1)[:, :count]

    def _judged(
        self, outputs: torch.Tensor, still: torch.Tensor, left_out: int | None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Tilt [rad] [n, 2] and expected angle of error [rad] [n] of what members give, [member, n,
        3], now and at rest; ``left_out`` as in ``predict``."""
        import torch

        tilts, errors = outputs[..., :2] - still, expected_error(outputs)
        others = reading = tilts
        if left_out is not None:
            others = torch.cat([tilts[:left_out], tilts[left_out + 1 :]])
            reading, errors = (values[left_out : left_out + 1] for values in (tilts, errors))
        spread2 = (others - others.mean(dim=0)).square().sum(dim=-1).mean(dim=0)
        own = self.config.error_factor * errors.mean(dim=0)
        return reading.mean(dim=0), (own.square() + spread2).sqrt()

    def predict_pixels(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tilt [rad] [n, 2] and expected angle of error [rad] [n] of raw features [n, feature]."""
        import torch

        with torch.no_grad():
            raw = torch.as_tensor(features, dtype=torch.float32, device=self.device).T
            tilt, error = self._judged(self._outputs(raw), self._still(raw), None)
        return tilt.cpu().numpy(), error.cpu().numpy()


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


@lru_cache(maxsize=16)
def _place(
    width_px: int, height_px: int, bands: int, block_px: int, device: torch.device
) -> torch.Tensor:
    """Places of blocks (``pixel_place``), shape [n, h, w]."""
    return place_of_blocks(pixel_place(width_px, height_px, bands), block_px).to(device)


@lru_cache(maxsize=16)
def _away(config: NormalModelConfig, block_px: int, device: torch.device) -> torch.Tensor:
    """Parts of their tilt that blocks may be off by, by where they are, float32, shape [h, w]."""
    import torch

    away = tensor_of(config.away(block_px), torch.float32) / AWAY
    return away.square().to(device)


def expected_error(outputs: torch.Tensor) -> torch.Tensor:
    """Expected angle of error [rad] [member, n] of raw outputs [member, n, 3]."""
    return outputs[..., 2].clamp(-12.0, 2.0).exp() + MIN_ERROR_RAD


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


def relative_normals(tilt_rad: Array) -> Array:
    """Unit normals whose rotation from +z is ``tilt_rad`` [rad], shape [..., 2] to [..., 3].

    The normal leans towards the tilt's direction; angles are cut at 85 degrees.
    """
    import torch

    tilt = tensor_of(tilt_rad)
    cut, lean = _cut(tilt)
    return as_given(torch.cat([tilt * lean, cut.cos()], dim=-1), tilt_rad)


def _cut(tilt: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Angle of tilts [..., 2], cut at 85 degrees, and its sine over the tilt, shape [..., 1]."""
    import torch

    angle = length2(tilt)[..., None]
    cut = angle.clamp(max=MAX_TILT_RAD)
    # sin(a) / a without dividing by a zero angle.
    return cut, torch.sinc(cut / math.pi) * torch.where(angle > cut, cut / angle, 1.0)


def _lean_slopes(tilt: torch.Tensor) -> torch.Tensor:
    """Slopes from rest of tilts, both of shape [2, ...], but for their sign."""
    cut, lean = _cut(tilt.movedim(0, -1))
    return tilt * (lean / cut.cos())[..., 0]
