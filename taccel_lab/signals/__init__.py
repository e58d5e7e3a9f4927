# SPDX-License-Identifier: Apache-2.0
"""What a tactile sensor reads off a simulated gel: images, markers, height map, normals, forces.

Every signal is built once from static data, reads a state with ``update(...)`` and then exposes
arrays whose first axis is the environment. ``SignalTactile`` works on device arrays throughout,
for many environments; ``FineSurface`` shows it the object's own shape where that touches.

The public names of ``__init__.pyi`` load their modules on first use: the networks, which every
command that reads a profile needs, are there without the solver and Warp.
"""

from taccel_lab.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
