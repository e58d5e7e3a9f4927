# SPDX-License-Identifier: Apache-2.0
"""Synthetic captures with known truth: faults of cameras and people, injected on purpose."""

from taccel_lab.calibration.synthetic.dots import disc_coverage, draw_dots
from taccel_lab.calibration.synthetic.faults import (
    add_dust,
    add_gradient,
    add_noise,
    blur,
    drift,
    poison,
    quantise,
    vignette,
)

__all__ = [
    "add_dust",
    "add_gradient",
    "add_noise",
    "blur",
    "disc_coverage",
    "draw_dots",
    "drift",
    "poison",
    "quantise",
    "vignette",
]
