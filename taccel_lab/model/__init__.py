# SPDX-License-Identifier: Apache-2.0
"""Static device arrays of a scene; ``build_model`` makes them.

The public names of ``__init__.pyi`` load their modules on first use: devices do without
kernels.
"""

from taccel_lab.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
