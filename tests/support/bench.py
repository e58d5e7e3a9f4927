# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab bench`` in this process."""

from __future__ import annotations

from collections.abc import Sequence

from taccel_lab.cli.app import main


def bench(words: Sequence[str]) -> int:
    """The exit code of ``taccel-lab bench WORDS``."""
    return main(["bench", *words])
