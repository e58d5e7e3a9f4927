# SPDX-License-Identifier: Apache-2.0
"""Surface normals from a tactile image: a small ensemble of networks, with its own uncertainty.

Networks map the features of a pixel (``network_answers``) to a tilt: the rotation, as a vector of
two angles, that takes the resting normal of that pixel to the present one. What the network gives
for no change of colour at the same pixel is subtracted, so that the background itself reads as the
resting surface, exactly, on curved gels too. Colour and position as inputs are those of
GelSight's calibration by balls (Yuan, Dong and Adelson, Sensors 17(12), 2017) and of gs_sdk's
network; the windows, the ensemble and the uncertainty are additions.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
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
)
from taccel_lab.reading.features import (
    Blocks,
    FeatureWindows,
    pixel_place,
    place_of_blocks,
)
from taccel_lab.reading.network_answers import MIN_ERROR_RAD, Networks
from taccel_lab.reading.room import room
from taccel_lab.signals.normals import rotate_from_z
from taccel_lab.signals.tensors import (
    Array,
    Given,
    as_given,
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
RAYLEIGH_MEAN = math.sqrt(math.pi / 2)
"""Mean length of a vector of two independent normal deviates of unit standard deviation."""


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
        if room() is not None:
            from taccel_lab.reading.fixed_surface import slopes_of

            flat = slopes_of(normals.reshape(-1, *normals.shape[-3:]), MAX_TILT_RAD)
            return as_given(flat.reshape(*normals.shape[:-1], 2), self.normals)
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
        self.networks = Networks(config, self.weights, device)
        """They answer of blocks."""
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

    def predict(
        self,
        image: Array,
        background: np.ndarray,
        *,
        mask: np.ndarray | None = None,
        rest_normals: np.ndarray | None = None,
        left_out: int | None = None,
        around: np.ndarray | None = None,
        every: int = 1,
    ) -> NormalMap[Array]:
        """Normals of whole images: by large blocks of pixels where the surface is smooth, and by
        small ones where it is not (``blocks``).

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
            every: Pixels along the smallest blocks that are read, which the maps are of: 1, 2, or
                ``LARGEST_PX``.
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
            windows = self._windows(images, light, kept)

            def answer(blocks: Blocks, picked: torch.Tensor | None) -> torch.Tensor:
                return self.networks.answer(blocks, picked, left_out)

            near, here = None if around is None else tensor_of(around, like=on), room()
            if every == LARGEST_PX:
                seen = windows.blocks if here is None else windows.sparse
                blocks = seen(LARGEST_PX)
                read = answer(blocks, None).unflatten(1, blocks.shape)
            elif here is None:
                patches = read_in_blocks(windows, answer, _lean_slopes, near, every)
                read = painted(patches, windows.count(every), every)
            else:
                read = read_in_room(windows, answer, near, here, every)
            if here is not None:
                return self._mapped(read, windows, image.shape[:-3], rest_normals, every)
            # Lines that go on beyond the outermost blocks may fall below any error there is.
            least = self.config.error_factor * MIN_ERROR_RAD
            tilt, error = read[:2].movedim(0, -1), read[2].clamp(min=least)
            if windows.mask is not None:
                held = windows.cover(every) > 0
                tilt = tilt.where(held[..., None], 0.0)
            lead = image.shape[:-3]
            tilt, error = (
                tilt.reshape(*lead, *tilt.shape[1:]),
                error.reshape(*lead, *error.shape[1:]),
            )
            normals = relative_normals(tilt)
            if rest_normals is not None:
                rest = place_of_blocks(rest_normals, every).movedim(0, -1)
                normals = rotate_from_z(normals, tensor_of(rest, tilt.dtype, on))
            sigma_deg = torch.rad2deg(error) / RAYLEIGH_MEAN
            if self.config.presses_px:
                away = _away(self.config, every, on.device)
                lean_deg = torch.rad2deg(length2(tilt)).to(sigma_deg.dtype)
                sigma_deg = torch.hypot(sigma_deg, away * lean_deg)
            found = NormalMap(normals, tilt, sigma_deg, self.config.radius95_sigmas * sigma_deg)
        return found.like(image)

    def _mapped(
        self,
        read: torch.Tensor,
        windows: FeatureWindows,
        lead: Sequence[int],
        rest_normals: Any,
        every: int,
    ) -> NormalMap[Any]:
        """What ``predict`` makes of what is read, in one kernel."""
        from taccel_lab.reading.fixed_surface import normal_maps

        kept, away, config = None, None, self.config
        if windows.mask is not None:
            kept = windows.cover(every) > 0
        if config.presses_px:
            away = _away(config, every, read.device)
        numbers = (
            config.error_factor * MIN_ERROR_RAD, MAX_TILT_RAD, math.degrees(1) / RAYLEIGH_MEAN,
            config.radius95_sigmas,
        )  # fmt: skip
        maps = [
            values.reshape(*lead, *values.shape[1:])
            for values in normal_maps(read, kept, away, numbers)
        ]
        if rest_normals is not None:
            rest = place_of_blocks(rest_normals, every).movedim(0, -1)
            maps[0] = rotate_from_z(maps[0], tensor_of(rest, read.dtype, read))
        return NormalMap(*maps)

    def _windows(
        self, images: torch.Tensor, light: torch.Tensor, mask: torch.Tensor | None
    ) -> FeatureWindows:
        config = self.config

        def place(block_px: int) -> torch.Tensor:
            return _place(
                config.width_px, config.height_px, config.position_bands, block_px, images.device
            )

        return FeatureWindows(
            images,
            config.scales_px,
            config.slope_scales_px,
            place,
            mask=mask,
            background=light if config.background else None,
            light=light,
        )

    def predict_pixels(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tilt [rad] [n, 2] and expected angle of error [rad] [n] of raw features [n, feature], by
        the ensemble."""
        import torch

        with torch.no_grad():
            raw = torch.as_tensor(features, dtype=torch.float32, device=self.device).T
            tilt, error = self.networks.answer_pixels(raw)
        return tilt.cpu().numpy(), error.cpu().numpy()


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
