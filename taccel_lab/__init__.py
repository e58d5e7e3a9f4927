# SPDX-License-Identifier: Apache-2.0
"""Design and calibrate vision-based tactile sensors on an IPC solver.

Importing this package is cheap: the public names of ``__init__.pyi`` load their modules on first
use, and heavy libraries load in the functions that need them.
"""

from pathlib import Path

from taccel_lab.lazy_names import lazy_names
from taccel_lab.registration import register_with_gymnasium

# In a checkout ``cad``, ``calibration`` and ``sensors`` stand beside this folder, and links in here
# lead to them. Where links are not checked out (Windows, some archives) they are found there.
_checkout = Path(__file__).resolve().parents[1]
if not (Path(__file__).parent / "cad").is_dir() and (_checkout / "cad" / "__init__.py").is_file():
    __path__.append(str(_checkout))

register_with_gymnasium()
__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
