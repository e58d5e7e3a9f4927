# SPDX-License-Identifier: Apache-2.0
"""A small network that reads for the ensemble of a calibration, and knows where it should not.

It was taught at calibration to answer as the ensemble does over what a reader sees
(``calibration/normals/distilling.py``), and by how much it is off the ensemble. That is one more
error of what it reads. Where it is expected to be more than half of the ensemble's own, the
ensemble reads instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

MOST_OFF = 0.5
"""Part of the ensemble's expected error that the small network may be off it."""
LOGARITHMS = -12.0, 2.0
"""Least and largest logarithm of an error [rad]."""


@dataclass(frozen=True)
class SmallAnswer:
    """What the small network says of blocks."""

    tilt_rad: torch.Tensor
    """Shape [n, 2]."""
    error_rad: torch.Tensor
    """Angle of error that the ensemble would expect, shape [n]."""
    off_rad: torch.Tensor
    """Angle that the tilt is expected to be off the ensemble's, shape [n]."""

    @classmethod
    def of(cls, outputs: torch.Tensor, still: torch.Tensor) -> SmallAnswer:
        """Answer of outputs [n, 4], of which tilts at rest are ``still`` [n, 2]."""
        error, off = outputs[:, 2:].clamp(*LOGARITHMS).exp().T
        return cls(outputs[:, :2] - still, error, off)

    @property
    def expected_rad(self) -> torch.Tensor:
        """Expected angle of error, by both, shape [n]."""
        return (self.error_rad.square() + self.off_rad.square()).sqrt()


def left_to_ensemble(error_rad: torch.Tensor, off_rad: torch.Tensor) -> torch.Tensor:
    """Blocks that the ensemble reads, bool, of errors as in ``SmallAnswer``, same shape."""
    return off_rad > MOST_OFF * error_rad
