# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab bench`` and ``python -m tools.bench`` in this process."""

from __future__ import annotations

from collections.abc import Sequence

from taccel_lab.cli.app import main
from tools.bench.__main__ import parse


def bench(words: Sequence[str]) -> int:
    """The exit code of ``taccel-lab bench WORDS``."""
    return main(["bench", *words])


def tools_bench(words: Sequence[str]) -> int:
    """The exit code of ``python -m tools.bench WORDS``."""
    return main(words, parse)
