# SPDX-License-Identifier: Apache-2.0
"""Ready-made experiments on a sensor: what happens, not what is measured or drawn.

The public names of ``__init__.pyi`` load their modules on first use: tools and depths do
without solver and Warp.
"""

from taccel_lab.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
