# SPDX-License-Identifier: Apache-2.0
"""What can be read from a solved step: forces, wrenches, tractions, sliding, stresses,
energies, momenta.

Every array is on the device, with the environment as its first axis. ``array.numpy()`` copies it to
the host, ``to_torch(array)`` shares its memory with torch, and ``from_dlpack`` of any library does.
"""

from taccel_lab.outputs.arrays import to_torch
from taccel_lab.outputs.contact_wrenches import PairWrenches
from taccel_lab.outputs.gel_frames import GelFrames
from taccel_lab.outputs.momentum import Momentum
from taccel_lab.outputs.outputs import Outputs
from taccel_lab.outputs.sliding import Sliding
from taccel_lab.outputs.surface_load import SurfaceLoad

__all__ = ["GelFrames", "Momentum", "Outputs", "PairWrenches", "Sliding", "SurfaceLoad", "to_torch"]
