# SPDX-License-Identifier: Apache-2.0
"""Force records made up in memory."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.capture import ForceRecord
from taccel_lab.calibration.capture.schema import RecordEntry, ToolEntry


def record(
    kind: str, radius_mm: float = 4.0, sigma_n: float | None = None, **columns
) -> ForceRecord:
    """A record of a ball."""
    entry = RecordEntry(
        file="a.csv",
        kind=kind,  # type: ignore[arg-type]
        tool=ToolEntry(kind="sphere", radius_mm=radius_mm),
        force_sigma_n=sigma_n,
    )
    arrays = {name: np.asarray(values, dtype=float) for name, values in columns.items()}
    return ForceRecord(entry, "folder/a.csv", "0" * 64, arrays)
