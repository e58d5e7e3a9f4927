# SPDX-License-Identifier: Apache-2.0
"""Physics of presses in tests: quicker than any that a user gets, and the default beside it."""

from __future__ import annotations

from taccel_lab.envs.physics import PHYSICS, Accuracy, PressMeshOptions, PressPhysics

_MESH = PressMeshOptions(elements_per_radius=2.0, core=4, rings=6)
"""2,325 nodes of a GelSight Mini."""
COARSE = PressPhysics(mesh=_MESH)
"""Tables take the error of their mesh from presses of ``FAST``."""
COARSER = PressPhysics(mesh=PressMeshOptions(elements_per_radius=1.5, core=4, rings=4))
"""Where only the way matters, not the force."""
COARSE_FAST = PressPhysics(Accuracy.FAST, mesh=_MESH)
"""The same under the name of the fast physics."""
FAST = PHYSICS[Accuracy.FAST]
DEFAULT = PHYSICS[Accuracy.DEFAULT]
