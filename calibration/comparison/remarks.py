# SPDX-License-Identifier: Apache-2.0
"""What the comparison of two profiles can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

OTHER_FAMILY = RemarkKind("other_family", Severity.WARNING, "different families: {a} and {b}")
SIGNIFICANT = RemarkKind(
    "significant",
    Severity.WARNING,
    "{block}.{field} differs by {difference:.4g}, {z:.1f} standard deviations: more than the "
    "spreads explain",
)
OTHER_COLORS = RemarkKind(
    "other_colors",
    Severity.WARNING,
    "the colour responses differ by {share:.0%} of their size: a model of one unit does not serve "
    "the other",
)
