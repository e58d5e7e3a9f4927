# SPDX-License-Identifier: Apache-2.0
"""A fake study in a process of its own: ``python -m tests.studies.run_fake ROOT PROCESSES``."""

from __future__ import annotations

import sys

from taccel_lab.studies.runner import run_study
from tests.studies.fake_kit import study

MODULI = {"min": 0.1, "max": 0.4, "count": 2, "scale": "log"}
CHANGES = {
    "parameters": {
        "thickness_mm": {"min": 3.0, "max": 8.0, "count": 6},
        "young_modulus_mpa": MODULI,
    }
}

if __name__ == "__main__":
    run_study(study(**CHANGES), sys.argv[1], processes=int(sys.argv[2]))
