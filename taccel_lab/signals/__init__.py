# SPDX-License-Identifier: Apache-2.0
"""What a tactile sensor reads off a simulated gel: images, markers, height map, normals, forces.

Every signal is built once from static data, reads a state with ``update(...)`` and then exposes
arrays whose first axis is the environment. ``SignalTactile`` works on device arrays throughout,
for many environments; ``FineSurface`` shows it the object's own shape where that touches.
"""

from taccel_lab.signals.contact_surface import ContactSurface
from taccel_lab.signals.fine_surface import FineSurface
from taccel_lab.signals.forces import resultant_wrench
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.normals import normals_from_height, normals_from_slopes
from taccel_lab.signals.tactile import SignalTactile

__all__ = [
    "ContactSurface",
    "FineSurface",
    "MarkerLayout",
    "SignalTactile",
    "normals_from_height",
    "normals_from_slopes",
    "resultant_wrench",
]
