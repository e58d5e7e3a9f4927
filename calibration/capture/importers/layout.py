# SPDX-License-Identifier: Apache-2.0
"""What an importer provides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions

FALLBACK_SENSOR = "flat_pad"
"""Where nothing says which sensor the captures are of."""


@dataclass(frozen=True)
class CaptureLayout:
    """One way in which people store captures."""

    name: str
    """Name on the command line."""
    title: str
    """One line: whose layout, and what tells it."""
    recognises: Callable[[Path], bool]
    """Whether a file or folder follows it; decodes a few images at most."""
    read: Callable[[Path, ImportOptions], list[Draft]]
    """One draft for each sensor or set; none where it is of another layout, which may be looked for
    less closely than by ``recognises``. Raises InputError naming the file, what was found and what
    is allowed."""
