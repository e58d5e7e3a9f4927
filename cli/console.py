# SPDX-License-Identifier: Apache-2.0
"""Output shared by the commands."""

from __future__ import annotations

import json
import sys
from typing import Any

from taccel_lab.output import to_jsonable


def print_json(value: Any) -> None:
    """Write ``value`` as indented JSON to standard output; NaN and infinities become null."""
    sys.stdout.write(json.dumps(to_jsonable(value), indent=2, allow_nan=False) + "\n")
