# SPDX-License-Identifier: Apache-2.0
"""Settings shared by all tests."""

from __future__ import annotations

import os

# Before numpy or torch start their thread pools: tests run in parallel processes.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

from hypothesis import HealthCheck, settings

# Shared machines stall now and then, which says nothing about the code: no deadlines. Examples are
# derandomised, so that a change that passed keeps passing; they still depend on the version of the
# library and on which of our modules a process has loaded, whose constants it tries. With
# TACCEL_LAB_EXPLORE=1 new ones are drawn: `make explore` does so.
settings.register_profile(
    "taccel",
    deadline=None,
    print_blob=True,
    derandomize=os.environ.get("TACCEL_LAB_EXPLORE", "0") != "1",
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("taccel")
