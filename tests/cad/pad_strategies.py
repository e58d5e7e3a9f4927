# SPDX-License-Identifier: Apache-2.0
"""Random pads for property-based tests."""

from __future__ import annotations

from hypothesis import strategies as st

from cad.parts.gel_pad import GelPad


@st.composite
def gel_pads(draw: st.DrawFn) -> GelPad:
    """Pads of the proportions of real sensors: flat or domed, with or without rim."""
    x, y = draw(st.floats(14, 34)), draw(st.floats(14, 34))
    rim = draw(st.sampled_from(["none", "chamfer", "fillet"]))
    crown = st.sampled_from([0.0, 60.0, 110.0, 190.0])
    corner = draw(st.floats(1.0, 3.0))
    return GelPad(
        length_x_mm=x,
        length_y_mm=y,
        corner_radius_mm=corner,
        thickness_mm=draw(st.floats(4.5, 7.0)),
        crown_radius_x_mm=draw(crown),
        crown_radius_y_mm=draw(crown),
        rim=rim,
        rim_mm=draw(st.floats(0.2, 0.6)),
        window_x_mm=x * draw(st.floats(0.5, 0.75)),
        window_y_mm=y * draw(st.floats(0.5, 0.75)),
    )
