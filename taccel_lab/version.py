# SPDX-License-Identifier: Apache-2.0
"""The version of the package, which every file that it writes states."""

__version__ = "0.1.0"
