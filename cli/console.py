# SPDX-License-Identifier: Apache-2.0
"""Output shared by the commands."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

from taccel_lab.output import to_jsonable

if TYPE_CHECKING:
    from rich.console import Console

_told = {"quiet": False}


def be_quiet(quiet: bool) -> None:
    """Whether commands leave out how far they are and what they noted; errors are said anyway."""
    _told["quiet"] = quiet


def notes() -> Console:
    """Where a command says how far it is and what it noted: standard error, nothing when quiet."""
    from rich.console import Console

    return Console(stderr=True, quiet=_told["quiet"])


def print_json(value: Any) -> None:
    """Write ``value`` as indented JSON to standard output; NaN and infinities become null."""
    sys.stdout.write(json.dumps(to_jsonable(value), indent=2, allow_nan=False) + "\n")
