# SPDX-License-Identifier: Apache-2.0
"""The gel itself, for goals such as 'the softest gel that ...'."""

from __future__ import annotations

from taccel_lab.studies.metrics.base import metric
from taccel_lab.studies.metrics.evidence import Evidence


@metric("gel_modulus", "MPa", "Young's modulus of the gel's first layer", "none", (), smooth=True)
def gel_modulus(evidence: Evidence) -> float:
    """Also of a gel that is given by its Shore hardness."""
    return evidence.parameters.layer_materials()[0].young_modulus_pa * 1e-6
