# SPDX-License-Identifier: Apache-2.0
"""What the search for contacts, and what is made of its contacts, can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import error, info, warning

PRESSES_LEFT_OUT = warning(
    "presses_left_out",
    "{lost} of {count} presses were left out: {names}. {reasons}.{advice}",
)
BALL_FROM_BELOW = info(
    "ball_from_below",
    "images bound the ball's radius from below only: {larger:.3g} mm would leave {larger_rms:.2f} "
    "levels, the stated {stated:g} mm leave {rms:.2f}. Is that its radius, not its diameter, and "
    "the scale right? Presses of known depth_mm, or of a second ball, tell",
)
WRONG_BALL_RADIUS = error(
    "wrong_ball_radius",
    "wrong ball radius or scale: the joint fit leaves {rms:.2f} levels with the stated {stated:g} "
    "mm and {best_rms:.2f} with {best:.3g} mm; {pinned} of {count} contacts are as large as the "
    "ball, and the colours ask for at least {lowest:.3g} mm. Measure the ball, and check mm_per_px",
)
