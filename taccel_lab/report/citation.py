# SPDX-License-Identifier: Apache-2.0
"""How a report is cited: the words of CITATION.cff, at the foot of every page."""

from taccel_lab.version import __version__

TITLE = "taccel-lab: design and calibration of vision-based tactile sensors on an IPC solver"
CITATION = f"The authors of taccel-lab. “{TITLE}”, version {__version__}."
