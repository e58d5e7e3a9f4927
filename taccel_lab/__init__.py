# SPDX-License-Identifier: Apache-2.0
"""Design and calibrate vision-based tactile sensors on an IPC solver.

Importing this package is cheap: the public names of ``__init__.pyi`` load their modules on first
use, and heavy libraries load in the functions that need them.
"""

from taccel_lab.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
