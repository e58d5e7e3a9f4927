# SPDX-License-Identifier: Apache-2.0
"""Dots found in one picture."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntFlag
from typing import Self

import numpy as np

from taccel_lab.calibration.dots import soft_ellipse as model
from taccel_lab.calibration.dots.blobs import DotScale


class DotFlag(IntFlag):
    """What is special about a dot; its centre is given nonetheless."""

    CUT = 1
    """Part of it lies outside the image: shape and size are taken from its neighbours."""
    MERGED = 2
    """It touched another dot and was split from it."""
    ODD = 4
    """Its size, shape or contrast is far from the others': perhaps no dot."""


@dataclass(frozen=True)
class DotFit:
    """Fitted dots."""

    parameters: np.ndarray
    """``soft_ellipse``'s, centres in the image, shape [dot, 10]."""
    covariance_px2: np.ndarray
    """Of the centres, shape [dot, 2, 2]; infinite where the fit has no hold."""
    seen: np.ndarray
    """Share of each ellipse that lies in the image and is nearest to this dot, shape [dot]."""
    converged: np.ndarray
    """Bool, shape [dot]."""

    @property
    def count(self) -> int:
        return len(self.parameters)

    @property
    def uv_px(self) -> np.ndarray:
        """Centres (u, v) [px], shape [dot, 2]."""
        return self.parameters[:, :2]

    @property
    def sigma_px(self) -> np.ndarray:
        """Standard deviations of the centres along u and v, shape [dot, 2]."""
        return np.sqrt(np.einsum("nii->ni", self.covariance_px2))

    @property
    def placed(self) -> np.ndarray:
        """Dots whose centre the fit found, bool, shape [dot]."""
        return self.converged & np.isfinite(self.covariance_px2).all(axis=(1, 2))

    @property
    def axes_px(self) -> np.ndarray:
        """Longer and shorter semi-axis, shape [dot, 2]."""
        return model.semi_axes(self.parameters)

    @property
    def radius_px(self) -> np.ndarray:
        """Mean radii, shape [dot]."""
        return model.mean_radius(self.parameters)

    @property
    def contrast(self) -> np.ndarray:
        """Share of the light that the paint adds, negative for dark dots, shape [dot]."""
        return self.parameters[:, model.CONTRAST]

    def select(self, which: np.ndarray) -> Self:
        """Some of the dots, in the order of ``which``."""
        return replace(self, **{name: values[which] for name, values in self._arrays().items()})

    def joined(self, others: Self) -> Self:
        """These dots, then others of the same picture."""
        more = others._arrays()
        both = {name: np.concatenate([own, more[name]]) for name, own in self._arrays().items()}
        return replace(self, **both)

    def _arrays(self) -> dict[str, np.ndarray]:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


@dataclass(frozen=True)
class Dots(DotFit):
    """The dots of a picture."""

    flags: np.ndarray
    """``DotFlag``s, uint8, shape [dot]."""
    scale: DotScale
    size_px: tuple[int, int]
    """Width and height of the image."""

    @property
    def whole(self) -> np.ndarray:
        """Dots that nothing is special about, bool, shape [dot]."""
        return self.flags == 0

    def flagged(self, flag: DotFlag) -> np.ndarray:
        """Dots that carry a flag, bool, shape [dot]."""
        return (self.flags & flag) != 0
