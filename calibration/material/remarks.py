# SPDX-License-Identifier: Apache-2.0
"""What the calibration of the material can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

_SECOND_TOOL = (
    "records of two tools in the same folder, a ball with a radius of at most half of the gel's "
    "thickness, and a flat punch about as wide as the gel is thick or a ball of two to four times "
    "the thickness"
)
"""What separates E and nu (docs/calibration_material.md)."""

# Indentation records.
UNUSUAL_MODULUS = RemarkKind(
    "unusual_modulus",
    Severity.WARNING,
    "{name}: about {modulus_pa:.3g} Pa is unusual for a gel of a tactile sensor ({low_pa:g} to "
    "{high_pa:g} Pa); check units and tool. {guess}",
)
FRICTION_UNSIMULATED = RemarkKind(
    "friction_unsimulated",
    Severity.WARNING,
    "whether the tool rubs with the profile's coefficient of {friction:g} is not known, and "
    "presses with it could not be simulated: {reason}",
)

# The fit to indentations.
NU_UNDETERMINED = RemarkKind(
    "nu_undetermined",
    Severity.INFO,
    "the records {verb} Poisson's ratio {bounds}; it is held, not calibrated",
)
MOONEY_RATIO_UNDETERMINED = RemarkKind(
    "mooney_ratio_undetermined",
    Severity.INFO,
    "the records {verb} the Mooney ratio {bounds}; it is held, not calibrated",
)
NU_EXCLUDED = RemarkKind(
    "nu_excluded",
    Severity.WARNING,
    "nu = {base:g} of the base profile lies outside the interval {low:.3g} to {high:.3g} that the "
    "records leave; {held:.3g} is used",
)
LAW_MISFIT = RemarkKind(
    "law_misfit",
    Severity.WARNING,
    "{name}: the simulated curve misses forces that it was not fitted to by {rms:.1%} (root mean "
    "square above a tenth of the largest); check the radius, the gel's thickness and where the "
    "depth is counted from",
    graver=Severity.ERROR,
)
PRESS_DEPTH = RemarkKind(
    "press_depth",
    Severity.INFO,
    "{name}: a press of the profile gives its forces at depths {shift_mm:.3f} mm "
    "{larger_or_smaller} than recorded: first touch lies {touch_mm:+.3f} mm from the record's "
    "zero ({low_mm:+.3f} to {high_mm:+.3f})",
)
LOAD_CELL_ZERO = RemarkKind(
    "load_cell_zero",
    Severity.INFO,
    "{name}: the load cell reads {zero_n:+.3g} N in air ({low_n:+.3g} to {high_n:+.3g}); that is "
    "taken off its forces",
)
TOUCH_SHIFT = RemarkKind(
    "touch_shift",
    Severity.WARNING,
    "{name}: first touch lies {touch_mm:+.2f} mm from where the record counts its depth; the fit "
    "allows for it, but look at how touch was detected",
)
YOUNG_WITH_NU = RemarkKind(
    "young_with_nu",
    Severity.INFO,
    "Young's modulus is known only together with Poisson's ratio (correlation {correlation:+.3f}) "
    "and is uncertain by {sigma:.0%} for that; "
    + _SECOND_TOOL
    + ", or nu held with --fix nu=..., gives it to about 1 %",
)
NOISE_UNDERSTATED = RemarkKind(
    "noise_understated",
    Severity.WARNING,
    "residuals are {factor:.1f} times the stated noise of the forces; intervals are widened to "
    "match",
)
FEW_DEGREES_OF_FREEDOM = RemarkKind(
    "few_degrees_of_freedom",
    Severity.WARNING,
    "{count} points and {fitted} fitted numbers: how close the fit comes to them says little. "
    "Predicted from the others, points are off by {rms:.1%} (root mean square; {worst:.1%} at "
    "most; {inside} of {predicted} in the 95 % interval stated for them). Record eight depths or "
    "more",
)
RECORDS_DISAGREE = RemarkKind(
    "records_disagree",
    Severity.WARNING,
    "{name} alone gives {own_pa:.4g} Pa, the records together {young_pa:.4g} Pa; check the radius "
    "of {tool}, its units and its touch point",
)
YOUNG_GIVEN_NU = RemarkKind(
    "young_given_nu",
    Severity.INFO,
    "Young's modulus holds for nu = {nu:g}: it is {low_pa:.4g} Pa for {low_nu:g} and "
    "{high_pa:.4g} Pa for {high_nu:g}; its interval is over nu from {least_nu:g} to {most_nu:g}. "
    + _SECOND_TOOL[0].upper()
    + _SECOND_TOOL[1:]
    + " determine nu",
)
YOUNG_UNCERTAIN = RemarkKind(
    "young_uncertain",
    Severity.WARNING,
    "Young's modulus is only known to {half:.0%} ({low_pa:.3g} to {high_pa:.3g} Pa); record more "
    "depths, and deeper ones, or a second tool",
)
FRICTION_ASSUMED = RemarkKind(
    "friction_assumed",
    Severity.WARNING,
    "friction is not measured: the presses fit best with a coefficient of {friction:g}, which is "
    "what the profile now says and what presses of it take; {others}. Record a slide",
)

# Slides.
NEVER_SLID = RemarkKind(
    "never_slid",
    Severity.WARNING,
    "{name}: the tangential force grows to the end of the stroke, the tool does not slide freely; "
    "friction is at least {least:.3g}. Move the tool farther sideways",
)
OFFSET_UNDETERMINED = RemarkKind(
    "offset_undetermined",
    Severity.INFO,
    "{name}: one direction and a steady load do not separate an offset of the tangential force "
    "from friction; 1 % of the load ({offset_n:.2g} N) of offset would change the coefficient by "
    "0.01. Slide back as well",
)
STICK_SLIP = RemarkKind(
    "stick_slip",
    Severity.WARNING,
    "{name}: the tool sticks and slips every {slip_mm:.2g} mm; friction reaches {static:.3g} "
    "before a slip and is {friction:.3g} on average. The solver has one coefficient: slide more "
    "slowly or more stiffly to separate them",
)
PARTLY_SLID = RemarkKind(
    "partly_slid",
    Severity.INFO,
    "{name}: {left_out} of {count} strokes never slide and are left out",
)
FRICTION_BY_LOAD = RemarkKind(
    "friction_by_load",
    Severity.WARNING,
    "friction goes with the load to the power {power:.2f} between {low_n:.3g} and {high_n:.3g} N; "
    "Coulomb's law has one coefficient, here the mean",
)
LEANING_UNKNOWN = RemarkKind(
    "leaning_unknown",
    Severity.WARNING,
    "{reason}, so what the ball leans on the gel is not taken off; friction may be up to 15 % "
    "lower than the ratio of the forces. A flat punch does not lean",
)
# Relaxation.
RELAXES = RemarkKind(
    "relaxes",
    Severity.WARNING,
    "{name}: at held depth the force falls by {part:.1%} within about {time_s:.3g} s; the "
    "solver's damping (Kelvin-Voigt) cannot relax, so no damping time is set. {modulus_pa:.4g} Pa "
    "is the modulus of the force that is left; a press that is faster than the relaxation is "
    "stiffer",
)
DAMPING_UNDETERMINED = RemarkKind(
    "damping_undetermined",
    Severity.INFO,
    "{name}: the force does not depend on the speed (up to {fastest:.3g} mm/s) by more than its "
    "noise; the damping time is below {high_s:.2g} s",
)
RELAXATION_MODULUS = RemarkKind(
    "relaxation_modulus",
    Severity.WARNING,
    "{name} alone gives {modulus_pa:.4g} Pa, {ratio:.2f} times that of the indentations; speed, "
    "touch point or tool differ",
)
