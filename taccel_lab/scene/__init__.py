# SPDX-License-Identifier: Apache-2.0
"""Scenes, and what they are made of: bodies, materials, joints, shapes of ``taccel_lab.bodies``.

The public names of ``__init__.pyi`` load their modules on first use: bodies and shapes do
without model and Warp.
"""

from taccel_lab.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
