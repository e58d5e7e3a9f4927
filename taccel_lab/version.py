# SPDX-License-Identifier: Apache-2.0
"""The version of the package, which every file that it writes states.

It is made from the newest tag of git when the package is installed or built; a checkout that was
never installed, on PYTHONPATH alone, does not know it.
"""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("taccel-lab")
except PackageNotFoundError:
    __version__ = "0.0.0"
