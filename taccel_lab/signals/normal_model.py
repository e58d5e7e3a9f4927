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

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.signals.model_settings import (
    require_camera_size,
)
from taccel_lab.signals.network_answers import QUESTIONS, forward, require_answers
from taccel_lab.signals.normal_features import (
    color_change,
)
from taccel_lab.signals.normal_model_config import NormalModelConfig
from taccel_lab.signals.normals import rotate_from_z

if TYPE_CHECKING:
    import torch

    from taccel_lab.profile import SensorProfile

MAX_TILT_RAD = math.radians(85.0)
MIN_ERROR_RAD = math.radians(0.02)
RAYLEIGH_MEAN = math.sqrt(math.pi / 2)
"""Mean length of a vector of two independent normal deviates of unit standard deviation."""
CHUNK_PIXELS = 2048
"""Read at once: what the layers give for so many stays in a core's cache, which takes half the time
of chunks that do not."""


@dataclass(frozen=True)
class NormalMap:
    """What the inverse model reads from one image."""

    normals: np.ndarray
    """Outward unit normals, gel frame, shape [height_px, width_px, 3]."""
    tilt_rad: np.ndarray
    """Rotation of each normal from rest, components along x and y, shape [h, w, 2]."""
    sigma_deg: np.ndarray
    """Standard deviation of each component of the tilt [degrees], shape [h, w]. The angle between
    the given and the true normal is expected to be 1.25 times this."""
    radius95_deg: np.ndarray
    """Angle within which the true normal lies in 95 % of a press's pixels [degrees], [h, w]."""

    def slope_sigma(self) -> np.ndarray:
        """Standard deviation of each component of the slope from rest, shape [h, w]: an angle's
        error grows with 1 + slope^2 where it becomes one of the slope."""
        tilt = np.minimum(np.linalg.norm(self.tilt_rad, axis=-1), MAX_TILT_RAD)
        return np.radians(self.sigma_deg) / np.cos(tilt) ** 2

    def slopes(self) -> np.ndarray:
        """dh/dx and dh/dy of the surface, shape [height_px, width_px, 2]."""
        upright = np.maximum(self.normals[..., 2:], math.cos(MAX_TILT_RAD))
        return -self.normals[..., :2] / upright


class NormalModel:
    """Normals of tactile images.

    ``weights`` holds float32 arrays ``layer<i>.weight`` [members, outputs, inputs] and
    ``layer<i>.bias`` [members, outputs].
    """

    def __init__(self, config: NormalModelConfig, weights: Mapping[str, np.ndarray]) -> None:
        self.config = config
        self.weights = {
            name: np.array(value, dtype=np.float32, order="C") for name, value in weights.items()
        }
        expected = expected_shapes(config)
        found = {name: value.shape for name, value in self.weights.items()}
        if found != expected:
            raise InputError(f"normal model weights have shapes {found}, expected {expected}")
        if not all(np.isfinite(value).all() for value in self.weights.values()):
            raise InputError("normal model weights hold NaN or infinite values")

    @classmethod
    def from_profile(cls, profile: SensorProfile) -> NormalModel:
        """The model in a profile's ``normals`` block.

        Raises InputError when it has none, one for images of another size than the camera's, or one
        that turns normals farther than they can be turned.
        """
        if profile.normals is None or profile.normal_weights is None:
            raise InputError(
                f"the profile of {profile.sensor.name} has no normals block; fit one with "
                "taccel-lab calibrate normals"
            )
        config = NormalModelConfig.from_dict(profile.normals.architecture)
        require_camera_size(profile, "normals", config.width_px, config.height_px)
        model = cls(config, profile.normal_weights)
        model.require_angles()
        return model

    def require_angles(self) -> None:
        """Refuse a network whose tilts are no angles, over twice the spread of its features."""
        rng, config = np.random.default_rng(0), self.config
        spread = rng.uniform(-2, 2, (QUESTIONS, config.input_count))
        raw = np.array(config.input_mean) + np.array(config.input_scale) * spread
        read, still = (
            forward(self.weights, config.normalise(values), "silu")[..., :2]
            for values in (raw, config.at_rest(raw))
        )
        sizes = np.degrees(np.linalg.norm((read - still).mean(axis=0), axis=-1))
        require_answers("the normal model", sizes, 360.0, "degrees", "a tilt has up to 90")

    @cached_property
    def _layers(self) -> list[tuple[torch.Tensor, torch.Tensor]]:
        return layer_tensors(self.config, self.weights)

    def predict(
        self,
        image: np.ndarray,
        background: np.ndarray,
        *,
        mask: np.ndarray | None = None,
        rest_normals: np.ndarray | None = None,
        left_out: int | None = None,
        every: int = 1,
    ) -> NormalMap:
        """Normals of a whole image.

        Args:
            image: RGB levels, shape [height_px, width_px, 3].
            background: The untouched sensor under the same light, same shape.
            mask: Pixels that count, bool, shape [height_px, width_px]. Masked pixels read as rest,
                whatever they hold.
            rest_normals: Outward unit normals of the undeformed face, shape [h, w, 3]; a flat face
                when None.
            left_out: The member that did not see this press when the others did. It reads alone,
                and its own error is no part of what it expects: how far it is off the others would
                tell it, as nothing does on a new press.
            every: Only every so many-th row and column is read, as in the whole image; the maps
                are of these.
        """
        shape = (self.config.height_px, self.config.width_px)
        for name, found in (("image", image.shape), ("background", background.shape)):
            if found != (*shape, 3):
                raise InputError(f"{name} has shape {found}, the normal model needs {(*shape, 3)}")
        change = color_change(image, background, mask)
        read = np.arange(shape[0] * shape[1]).reshape(shape)[::every, ::every]
        picked = None if every == 1 else read.ravel()
        features = self.config.image_features(change, background, mask=mask, picked=picked)
        features = features.reshape(-1, self.config.input_count)
        still = None if self.config.background else self._tilts_at_rest
        if still is not None and picked is not None:
            still = still[:, picked]
        tilt, error = self.predict_pixels(features, still, left_out)
        tilt, error = tilt.reshape(*read.shape, 2), error.reshape(read.shape)
        if mask is not None:
            tilt[~mask[::every, ::every]] = 0.0
        normals = relative_normals(tilt)
        if rest_normals is not None:
            normals = rotate_from_z(normals, rest_normals[::every, ::every])
        sigma_deg = np.degrees(error) / RAYLEIGH_MEAN
        return NormalMap(normals, tilt, sigma_deg, self.config.radius95_sigmas * sigma_deg)

    @cached_property
    def _tilts_at_rest(self) -> torch.Tensor:
        """What each member gives for every pixel of an unchanged image, [member, pixel, 2]."""
        import torch

        empty = np.zeros((self.config.height_px, self.config.width_px, 3), dtype=np.float32)
        features = self.config.image_features(empty, empty).reshape(-1, self.config.input_count)
        with torch.inference_mode():
            parts = [
                network(self._layers, self._inputs(features[start : start + CHUNK_PIXELS]))[..., :2]
                for start in range(0, len(features), CHUNK_PIXELS)
            ]
            return torch.cat(parts, dim=1)

    def _inputs(self, raw: np.ndarray) -> torch.Tensor:
        import torch

        return torch.from_numpy(self.config.normalise(raw)).expand(self.config.members, -1, -1)

    def predict_pixels(
        self,
        features: np.ndarray,
        tilts_at_rest: torch.Tensor | None = None,
        left_out: int | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Tilt [rad] [n, 2] and expected angle of error [rad] [n] of raw features [n, feature].

        ``tilts_at_rest`` [member, n, 2] saves the work of finding them again; ``left_out`` as in
        ``predict``.
        """
        import torch

        reading, others = list(range(self.config.members)), list(range(self.config.members))
        if left_out is not None:
            reading = [left_out]
            others.remove(left_out)

        tilt = np.empty((len(features), 2))
        error = np.empty(len(features))
        with torch.inference_mode():
            for start in range(0, len(features), CHUNK_PIXELS):
                part = slice(start, start + CHUNK_PIXELS)
                raw = features[part]
                outputs = network(self._layers, self._inputs(raw))
                if tilts_at_rest is None:
                    still = network(self._layers, self._inputs(self.config.at_rest(raw)))[..., :2]
                else:
                    still = tilts_at_rest[:, part]
                tilts, errors = outputs[..., :2] - still, expected_error(outputs)
                agreed = tilts[others].mean(dim=0)
                spread2 = (tilts[others] - agreed).square().sum(dim=-1).mean(dim=0)
                own = self.config.error_factor * errors[reading].mean(dim=0)
                tilt[part] = tilts[reading].mean(dim=0).numpy()
                error[part] = (own.square() + spread2).sqrt().numpy()
        return tilt, error


def expected_shapes(config: NormalModelConfig) -> dict[str, tuple[int, ...]]:
    """Shape of each weight array by name, in the order of the layers."""
    shapes: dict[str, tuple[int, ...]] = {}
    for i, (outputs, inputs) in enumerate(config.layer_sizes()):
        shapes[f"layer{i}.weight"] = (config.members, outputs, inputs)
        shapes[f"layer{i}.bias"] = (config.members, outputs)
    return shapes


def layer_tensors(
    config: NormalModelConfig, weights: Mapping[str, np.ndarray]
) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """(weight, bias) of each layer as torch tensors, members first."""
    import torch

    return [
        (torch.from_numpy(weights[f"layer{i}.weight"]), torch.from_numpy(weights[f"layer{i}.bias"]))
        for i in range(len(config.layer_sizes()))
    ]


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


def relative_normals(tilt_rad: np.ndarray) -> np.ndarray:
    """Unit normals whose rotation from +z is ``tilt_rad`` [rad], shape [..., 2] to [..., 3].

    The normal leans towards the tilt's direction; angles are cut at 85 degrees.
    """
    angle = np.linalg.norm(tilt_rad, axis=-1, keepdims=True)
    cut = np.minimum(angle, MAX_TILT_RAD)
    # sin(a) / a without dividing by a zero angle.
    lean = np.sinc(cut / np.pi) * np.divide(
        cut, angle, out=np.ones_like(angle), where=angle > MAX_TILT_RAD
    )
    return np.concatenate([tilt_rad * lean, np.cos(cut)], axis=-1)
