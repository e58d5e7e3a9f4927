# SPDX-License-Identifier: Apache-2.0
"""The processor cores that the system lets this process use."""

import os


def bound_cores() -> int:
    """Cores that this process is bound to; all of the machine on systems without such bounds."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1  # macOS
