# SPDX-License-Identifier: Apache-2.0
"""Contact circles as arrays of u, v and radius, and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle


def circle_array(circles: Sequence[ContactCircle]) -> np.ndarray:
    """u, v and radius of each circle [px], shape [n, 3]."""
    return np.array([(c.u_px, c.v_px, c.radius_px) for c in circles]).reshape(-1, 3)


def circle_of(shape: np.ndarray) -> ContactCircle:
    """The circle of u, v and radius [px], shape [3]."""
    return ContactCircle(*(float(x) for x in shape))
