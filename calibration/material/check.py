# SPDX-License-Identifier: Apache-2.0
"""Findings about force records: a tool without a size, units that no gel can have."""

from __future__ import annotations

from taccel_lab.calibration.capture.folder import CaptureFolder, ForceRecord
from taccel_lab.calibration.capture.records import LIKELY_MPA, apparent_modulus_mpa
from taccel_lab.calibration.remarks import error, warning
from taccel_lab.report.remark import Remark

TOOL_UNKNOWN = error(
    "tool_unknown",
    "{record}: the radius of the {tool} is missing; give tool = {{ kind, radius_mm }}",
    ("material",),
)
MODULUS_UNUSUAL = warning(
    "modulus_unusual",
    "{record}: by Hertz the gel would have {modulus:.3g} MPa, gels on a window look {low:g} to "
    "{high:g} MPa: check the units of force and depth and the tool's radius",
    ("material",),
)


def check_records(folder: CaptureFolder) -> list[Remark]:
    """Findings about all records."""
    return [finding for record in folder.records for finding in _check_record(record)]


def _check_record(record: ForceRecord) -> list[Remark]:
    entry, columns = record.entry, record.columns
    findings = []
    if entry.tool.radius_mm is None and entry.tool.kind != "flat":
        findings.append(TOOL_UNKNOWN(record=record.source, tool=entry.tool.kind))
    if entry.kind == "indentation" and entry.tool.radius_mm is not None:
        modulus = apparent_modulus_mpa(
            columns["depth_mm"], columns["force_n"], entry.tool.radius_mm
        )
        if not LIKELY_MPA[0] <= modulus <= LIKELY_MPA[1]:
            findings.append(
                MODULUS_UNUSUAL(
                    record=record.source, modulus=modulus, low=LIKELY_MPA[0], high=LIKELY_MPA[1]
                )
            )
    return findings
