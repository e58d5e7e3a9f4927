# SPDX-License-Identifier: Apache-2.0
"""What the calibration of the material can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import info, warning

_SECOND_TOOL = (
    "records of two tools in the same folder, a ball with a radius of at most half of the gel's "
    "thickness, and a flat punch about as wide as the gel is thick or a ball of two to four times "
    "the thickness"
)
"""What separates E and nu (docs/calibration_material.md)."""

# Indentation records.
UNUSUAL_MODULUS = warning(
    "unusual_modulus",
    "{name}: about {modulus_pa:.3g} Pa is unusual for a gel of a tactile sensor ({low_pa:g} to "
    "{high_pa:g} Pa); check units and tool. {guess}",
)

# The fit to indentations.
TOUCH_SHIFT = warning(
    "touch_shift",
    "{name}: first touch lies {touch_mm:+.2f} mm from where the record counts its depth; the fit "
    "allows for it, but look at how touch was detected",
)
RECORDS_DISAGREE = warning(
    "records_disagree",
    "{name} alone gives {own_pa:.4g} Pa, the records together {young_pa:.4g} Pa; check the radius "
    "of {tool}, its units and its touch point",
)
YOUNG_GIVEN_NU = info(
    "young_given_nu",
    "Young's modulus holds for nu = {nu:g}: it is {low_pa:.4g} Pa for {low_nu:g} and "
    "{high_pa:.4g} Pa for {high_nu:g}; its interval is over nu from {least_nu:g} to {most_nu:g}. "
    + _SECOND_TOOL[0].upper()
    + _SECOND_TOOL[1:]
    + " determine nu",
)
YOUNG_UNCERTAIN = warning(
    "young_uncertain",
    "Young's modulus is only known to {half:.0%} ({low_pa:.3g} to {high_pa:.3g} Pa); record more "
    "depths, and deeper ones, or a second tool",
)
FRICTION_ASSUMED = warning(
    "friction_assumed",
    "friction is not measured: the presses fit best with a coefficient of {friction:g}, which is "
    "what the profile now says and what presses of it take; {others}. Give it with --fix friction=",
)
