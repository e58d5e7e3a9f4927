# SPDX-License-Identifier: Apache-2.0
"""Figures of other simulators with their conditions, ``peers.json``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

FIELD = Path(__file__).parent / "peers.json"


def read_field() -> dict[str, Any]:
    """On the peg scene, and others."""
    return json.loads(FIELD.read_text(encoding="utf-8"))
