# SPDX-License-Identifier: Apache-2.0
"""``python -m taccel_lab.benchmarks``."""

import sys

from taccel_lab.benchmarks.command_line import main

if __name__ == "__main__":
    sys.exit(main())
