# SPDX-License-Identifier: Apache-2.0
"""The version of the package, which every file that it writes states.

It stands here alone: the build reads this line, and the newest section of CHANGELOG.md bears it.
"""

__version__ = "0.2.0"
