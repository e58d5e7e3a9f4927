# SPDX-License-Identifier: Apache-2.0
"""Where results that are slow to make are kept, and the names that they are kept under."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.output import to_jsonable

CACHE_VARIABLE = "TACCEL_LAB_CACHE"


def cache_folder() -> Path:
    """$TACCEL_LAB_CACHE, or taccel_lab in $XDG_CACHE_HOME or ~/.cache."""
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "taccel_lab"


def content_key(recipe: Mapping[str, Any]) -> str:
    """SHA-256 of a recipe of plain values and arrays; equal recipes give equal keys."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            data = np.ascontiguousarray(value)
            digest = hashlib.sha256(data.tobytes()).hexdigest()
            return {"array": digest, "shape": list(data.shape), "dtype": data.dtype.str}
        return to_jsonable(value)

    text = json.dumps({k: plain(v) for k, v in recipe.items()}, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
