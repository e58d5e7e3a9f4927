# SPDX-License-Identifier: Apache-2.0
"""What a tactile sensor reads off a simulated gel: height map, normals, contact, forces.

Every signal is built once from static data, reads a state with ``update(...)`` and then exposes
arrays whose first axis is the environment.
"""

from taccel_lab.signals.contact_surface import ContactSurface
from taccel_lab.signals.forces import SignalWrench, resultant_wrench
from taccel_lab.signals.height_map import SignalHeightMap, SurfaceMode
from taccel_lab.signals.normals import normals_from_height, normals_from_slopes
from taccel_lab.signals.rigid_surface import HeightFieldSurface, RigidSurface, SphereSurface
from taccel_lab.signals.surface_fusion import SignalFusedSurface

__all__ = [
    "ContactSurface",
    "HeightFieldSurface",
    "RigidSurface",
    "SignalFusedSurface",
    "SignalHeightMap",
    "SignalWrench",
    "SphereSurface",
    "SurfaceMode",
    "normals_from_height",
    "normals_from_slopes",
    "resultant_wrench",
]
