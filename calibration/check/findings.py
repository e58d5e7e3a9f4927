# SPDX-License-Identifier: Apache-2.0
"""What a check says: findings, worst first, and what each block of a profile still needs."""

from __future__ import annotations

from collections.abc import Sequence

from taccel_lab.report.remark import Remark, Severity

COMMANDS = (
    "camera",
    "scale",
    "background",
    "color",
    "normals",
    "depth",
    "markers",
    "material",
)
"""Blocks that captures calibrate, by the name of their command."""
_ORDER = {Severity.ERROR: 0, Severity.WARNING: 1, Severity.INFO: 2}
MAX_NAMES = 6


def worst_first(findings: Sequence[Remark]) -> list[Remark]:
    """Errors, warnings, information; within each the ones about most images first."""
    return sorted(findings, key=lambda f: (_ORDER[f.severity], -len(f.frames)))


def name_some(names: Sequence[str]) -> str:
    """A few names and how many more there are."""
    shown = ", ".join(names[:MAX_NAMES])
    return shown + (f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else "")
