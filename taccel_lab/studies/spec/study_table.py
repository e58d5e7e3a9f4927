# SPDX-License-Identifier: Apache-2.0
"""The table of a study file, with values of parameters in place of what stands there of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from taccel_lab.files.documents import TOML_LIMIT_BYTES, read_toml
from taccel_lab.files.regular_file import read_text

Swept = Mapping[str, Sequence[float | str]]
"""Values by parameter."""


def study_table(path: Path, swept: Swept | None = None) -> dict[str, Any]:
    """The table; ``swept`` parameters take these values, in a grid as in a random sweep.

    For an optimiser, which searches ranges, a parameter of one value becomes a fixed one.
    """
    table = read_toml(path)
    for name, values in (swept or {}).items():
        for other in ("parameters", "fixed", "tied"):
            if isinstance(table.get(other), dict):
                table[other].pop(name, None)
        sweep = table.get("sweep")
        searched = isinstance(sweep, dict) and sweep.get("kind") == "optimize"
        if searched and len(values) == 1:
            table.setdefault("fixed", {})[name] = values[0]
        else:
            table.setdefault("parameters", {})[name] = list(values)
    return table


def study_text(path: Path, swept: Swept | None = None) -> str:
    """The study as a file of its own: as it stands, or written anew with the ``swept`` values."""
    if not swept:
        return read_text(path, TOML_LIMIT_BYTES, "a study file")
    import tomli_w

    return tomli_w.dumps(study_table(path, swept))
