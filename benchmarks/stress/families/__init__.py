# SPDX-License-Identifier: Apache-2.0
"""All families of the stress; importing this registers them."""

from taccel_lab.benchmarks.stress.families import (
    close_calls,
    grasps,
    impacts,
    mechanisms,
    presses,
    strains,
)

__all__ = ["close_calls", "grasps", "impacts", "mechanisms", "presses", "strains"]
