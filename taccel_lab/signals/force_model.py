# SPDX-License-Identifier: Apache-2.0
"""Force from a tactile image: a small convolutional network, with its uncertainty and its range.

The network sees the change of colour, image minus the untouched sensor's, averaged over pixels of
equal area, and the moved markers where the gel has some. It gives the force on the object for each
patch of the image and the area in contact in it; the force is their sum, and the moment is that of
the patches' forces about the gel's origin and a correction for what lies between them and above. A
standard deviation of each component comes with it.

Forces of an elastic gel under a given motion are proportional to its modulus, which no image shows.
The network tells them for the modulus that it was trained with; ``ForceModel`` scales them to the
profile's, and adds what is not known of it to the standard deviations.

Whether an image is like those of the training is asked four ways: the Mahalanobis distance of the
network's last features from the training's (Lee et al., NeurIPS 2018), that of simple statistics of
the change of colour, whether a colour, and whether the prediction lies beyond anything that was
trained.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.force_settings import LEVELS, ForceModelConfig, with_color_limits
from taccel_lab.networks.settings import checked_weights
from taccel_lab.signals.force_network import (
    distances,
    forward,
    marker_planes,
    patch_centers_mm,
    reduced,
)

if TYPE_CHECKING:
    import torch

    from taccel_lab.profile import SensorProfile


@dataclass(frozen=True)
class ForceReading:
    """What one image tells. Forces are of the gel on the object, gel frame: a press is +z."""

    force_n: np.ndarray
    """[3]."""
    moment_nmm: np.ndarray
    """Moment about the gel's origin, [3]."""
    area_mm2: float
    sigma: np.ndarray
    """Standard deviations of ``TARGETS``, [7]."""
    patch_forces_n: np.ndarray
    """[row, column, 3]; their sum is ``force_n``."""
    patch_centers_mm: np.ndarray
    """Gel xy, [row, column, 2]."""
    distances: np.ndarray
    """Distances of features, statistics and colours from the training's, over their limits, [3]."""
    outside: tuple[str, ...]
    """Why the image is not like those of the training, in sentences; empty when it is."""

    @property
    def touched(self) -> bool:
        """Whether the force along z is above twice its standard deviation."""
        return bool(self.force_n[2] > 2 * self.sigma[2])

    @property
    def center_mm(self) -> np.ndarray | None:
        """Middle of the pressing patches, gel xy, [2]; None without a touch."""
        pressing = np.maximum(self.patch_forces_n[..., 2], 0.0)
        total = pressing.sum()
        if not self.touched or total <= 0:
            return None
        return np.einsum("rc,rcx->x", pressing, self.patch_centers_mm) / total

    def figures(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        center = self.center_mm
        return {
            "force_n": self.force_n.tolist(),
            "force_sigma_n": self.sigma[:3].tolist(),
            "moment_nmm": self.moment_nmm.tolist(),
            "moment_sigma_nmm": self.sigma[3:6].tolist(),
            "area_mm2": self.area_mm2,
            "area_sigma_mm2": float(self.sigma[6]),
            "touched": self.touched,
            "center_mm": None if center is None else center.tolist(),
            "patch_forces_n": self.patch_forces_n.tolist(),
            "patch_centers_mm": self.patch_centers_mm.tolist(),
            "distance_of_features": float(self.distances[0]),
            "distance_of_statistics": float(self.distances[1]),
            "distance_of_colors": float(self.distances[2]),
            "inside_training": not self.outside,
            "outside": list(self.outside),
        }


class ForceModel:
    """Forces of tactile images.

    ``weights`` holds float32 arrays as ``weight_shapes`` of its settings lists them: layers, and
    mean and whitening matrix of what is compared with the training.
    """

    def __init__(
        self,
        config: ForceModelConfig,
        weights: Mapping[str, np.ndarray],
        grid: PixelGrid,
        young_modulus_pa: float | None = None,
    ) -> None:
        """``grid`` is that of the images; ``young_modulus_pa`` that of the gel, the training's when
        None."""
        self.config, self.grid = config, grid
        self.stiffness = (young_modulus_pa or config.young_modulus_pa) / config.young_modulus_pa
        self.weights = checked_weights(
            "force model", config.weight_shapes(), with_color_limits(weights)
        )

    @classmethod
    def from_profile(cls, profile: SensorProfile) -> ForceModel:
        """The model in a profile's ``force`` block, scaled to its modulus; raises InputError when
        it has none."""
        if profile.force is None or profile.force_weights is None:
            raise InputError(
                f"the profile of {profile.sensor.name} has no force block; train one with "
                "taccel-lab calibrate force"
            )
        config = ForceModelConfig.from_dict(profile.force.architecture)
        return cls(config, profile.force_weights, profile.grid(), profile.material.young_modulus_pa)

    @cached_property
    def tensors(self) -> dict[str, torch.Tensor]:
        import torch

        return {name: torch.from_numpy(value) for name, value in self.weights.items()}

    @cached_property
    def centers_mm(self) -> np.ndarray:
        """Gel xy of the patches' centres, [row, column, 2]."""
        return patch_centers_mm(self.config, self.grid)

    def read(
        self,
        image: np.ndarray,
        background: np.ndarray,
        markers: tuple[np.ndarray, np.ndarray] | None = None,
        *,
        planes: np.ndarray | None = None,
    ) -> ForceReading:
        """The force behind one image.

        Args:
            image: RGB levels, shape [height_px, width_px, 3].
            background: The untouched sensor, same shape.
            markers: Places at rest and ways from there (u, v) [px], shape [marker, 2] each, in any
                order; those that are not seen are left out. For a model that sees markers.
            planes: The same as ``marker_planes``, in place of ``markers``.
        """
        import torch

        config = self.config
        for name, array in (("image", image), ("background", background)):
            if array.shape != (config.height_px, config.width_px, 3):
                raise InputError(
                    f"{name} is {list(array.shape)}, the force model needs "
                    f"{[config.height_px, config.width_px, 3]} (height, width, RGB)"
                )
        if markers is not None:
            planes = marker_planes(*markers, config, self.grid)
        if config.markers and planes is None:
            raise InputError("this force model sees markers, too, but none were given")
        change = reduced(image, config) - reduced(background, config)
        seen = planes[None] if config.markers and planes is not None else None
        moved = None if seen is None else torch.from_numpy(seen)
        with torch.no_grad():
            levels = torch.from_numpy(change.transpose(2, 0, 1)[None].copy())
            centers = torch.from_numpy(self.centers_mm.astype(np.float32))
            output = forward(self.tensors, config, levels / LEVELS, moved, centers)
            away = distances(levels, output["features"], self.tensors)[0].numpy()
        return self._reading(output, away / np.array(config.distance_limits))

    def _reading(self, output: Mapping[str, torch.Tensor], distances: np.ndarray) -> ForceReading:
        config, factor = self.config, self.stiffness
        patches = output["patches"][0].permute(1, 2, 0).numpy().astype(np.float64) * factor
        targets = output["targets"][0].numpy().astype(np.float64)
        sigma = output["sigma"][0].numpy() * np.array(config.sigma_factor, dtype=np.float64)
        outside = self._outside(targets, float(output["patches"][0, 2].amax()), distances)
        targets[:6] *= factor
        sigma[:6] *= factor
        sigma[:6] = np.hypot(sigma[:6], config.stiffness_relative * np.abs(targets[:6]))
        return ForceReading(
            force_n=patches.sum(axis=(0, 1)),
            moment_nmm=targets[3:6],
            area_mm2=float(targets[6]),
            sigma=sigma,
            patch_forces_n=patches,
            patch_centers_mm=self.centers_mm,
            distances=distances,
            outside=tuple(outside),
        )

    def _outside(self, targets: np.ndarray, patch_n: float, distances: np.ndarray) -> list[str]:
        said = []
        if not distances[1] <= 1:
            said.append(
                f"colours: the change from the untouched image is {distances[1]:.1f} times as far "
                "from the training's as its limit; is it this sensor, with this background?"
            )
        if not distances[0] <= 1:
            said.append(
                f"pattern: what the network sees is {distances[0]:.1f} times as far from the "
                "training's as its limit"
            )
        if not distances[2] <= 1:
            said.append(
                f"reach of colours: one changes {distances[2]:.2f} times as much as the limit, "
                "which is the most of the training's touches and a margin; is it a steeper or "
                "deeper touch than those?"
            )
        reached = (targets[2], math.hypot(targets[0], targets[1]), targets[6], patch_n)
        names = (
            ("force along z", "N"), ("force along the face", "N"), ("area", "mm2"),
            ("force of a patch", "N"),
        )  # fmt: skip
        for (name, unit), value, most in zip(names, reached, self.config.most, strict=True):
            if not value <= most:
                said.append(
                    f"{name}: {value:.3g} {unit} at the training's modulus is above "
                    f"{most:.3g} {unit}, the most that was trained"
                )
        return said
