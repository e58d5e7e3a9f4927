# SPDX-License-Identifier: Apache-2.0
"""Random pads for property-based tests."""

from __future__ import annotations

from hypothesis import strategies as st

from taccel_lab.cad.parts.gel_pad import GelPad


@st.composite
def gel_pads(draw: st.DrawFn) -> GelPad:
    """Pads of the proportions of real sensors: flat or domed, with or without rim."""
    x, y = draw(st.floats(14, 34)), draw(st.floats(14, 34))
    rim = draw(st.sampled_from(["none", "chamfer", "fillet"]))
    crown = st.sampled_from([0.0, 60.0, 110.0, 190.0])
    corner = draw(st.floats(1.0, 3.0))
    radii = draw(crown), draw(crown)
    # A little more than the crown's drop at the corners, so that a wall is left below it.
    drop = sum(1.2 * (size / 2) ** 2 / (2 * r) for size, r in zip((x, y), radii, strict=True) if r)
    return GelPad(
        length_x_mm=x,
        length_y_mm=y,
        corner_radius_mm=corner,
        thickness_mm=max(draw(st.floats(4.5, 7.0)), drop + 1.2),
        crown_radius_x_mm=radii[0],
        crown_radius_y_mm=radii[1],
        rim=rim,
        rim_mm=draw(st.floats(0.2, 0.6)),
        window_x_mm=x * draw(st.floats(0.5, 0.75)),
        window_y_mm=y * draw(st.floats(0.5, 0.75)),
    )
