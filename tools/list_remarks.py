# SPDX-License-Identifier: Apache-2.0
"""Print docs/remarks.md: ``python tools/list_remarks.py > docs/remarks.md``."""

import sys

from taccel_lab import calibration, learning
from taccel_lab.calibration.remarks import remark_table

sys.stdout.write(remark_table(calibration, learning))
