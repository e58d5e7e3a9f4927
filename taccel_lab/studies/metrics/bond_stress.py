# SPDX-License-Identifier: Apache-2.0
"""Stress that the bond between gel and backing has to bear."""

from __future__ import annotations

from taccel_lab.studies.metrics.base import metric
from taccel_lab.studies.metrics.evidence import Evidence, at_load


@metric(
    "bond_stress", "kPa",
    "largest von Mises stress at the bond under {tool} at {load}", "lower",
    ("sphere",), smooth=True,
)  # fmt: skip
def bond_stress(evidence: Evidence) -> float:
    """Peak over the bonded nodes; stress at a node is the mean of its elements."""
    record = evidence.one("sphere")
    return at_load(record, record.bond_peak_pa[record.down], evidence.load_n) * 1e-3


@metric(
    "bond_stress_shear", "kPa",
    "largest von Mises stress at the bond in the press with shear and twist, over all its steps",
    "lower", ("shear",),
)  # fmt: skip
def bond_stress_shear(evidence: Evidence) -> float:
    """Peak over the steps and the bonded nodes."""
    return float(evidence.one("shear").bond_peak_pa.max()) * 1e-3
