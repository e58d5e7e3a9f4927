# SPDX-License-Identifier: Apache-2.0
"""A fake study in a process of its own:
``python -m tests.studies.run_fake ROOT PROCESSES [SHARD [optuna]]``."""

from __future__ import annotations

import sys

from taccel_lab.files.shard import Shard
from taccel_lab.studies.evaluate.runner import run_study
from tests.support.fake_kit import study

MODULI = {"min": 0.1, "max": 0.4, "count": 2, "scale": "log"}
CHANGES = {
    "parameters": {
        "thickness_mm": {"min": 3.0, "max": 8.0, "count": 6},
        "young_modulus_mpa": MODULI,
    }
}

SEARCH = {
    "parameters": {
        "thickness_mm": {"min": 3, "max": 8},
        "young_modulus_mpa": {"min": 0.05, "max": 1, "scale": "log"},
    },
    "sweep": {"kind": "optimize", "count": 14, "method": "TPE"},
    "objectives": [{"minimize": "blur"}, {"maximize": "range"}],
}

if __name__ == "__main__":
    root, processes, *rest = sys.argv[1:]
    run_study(
        study(**(SEARCH if "optuna" in rest else CHANGES)),
        root,
        processes=int(processes),
        shard=Shard.parse(rest[0]) if rest else None,
    )
