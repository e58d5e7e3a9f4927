# SPDX-License-Identifier: Apache-2.0
"""Standard presses in words, for lists and documentation."""

from __future__ import annotations

import math

from studies.presses import StandardPress


def press_in_words(press: StandardPress) -> str:
    """Indenters, depth, motion and places of a press, in one line."""
    parts = [" / ".join(press.indenters)]
    if press.depth_mm:
        parts.append(f"{press.depth_mm:g} mm deep")
    else:
        most = press.depth_limit_mm
        limit = f", at most {most:g} mm" if math.isfinite(most) else ""
        parts.append(f"{press.depth_fraction:.0%} of the gel's thickness deep{limit}")
    if press.shear_fraction:
        back = " and back" if press.shear_back else ""
        parts.append(f"sideways by {press.shear_fraction:g} of the depth{back}")
    if press.twist_deg:
        parts.append(f"turned by {press.twist_deg:g} deg")
    if press.release:
        parts.append("up again")
    if len(press.places) > 1:
        parts.append(f"in {len(press.places)} places")
    return "; ".join([*parts, f"{len(press.waypoints())} steps"])
