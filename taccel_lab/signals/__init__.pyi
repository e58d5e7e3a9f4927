# SPDX-License-Identifier: Apache-2.0
"""The public names and their modules; read by type checkers and by ``lazy_names``."""

from taccel_lab.signals.fine_surface import FineSurface as FineSurface
from taccel_lab.signals.forces import resultant_wrench as resultant_wrench
from taccel_lab.signals.gradient_recovery import ContactFaceMesh as ContactFaceMesh
from taccel_lab.signals.markers import MarkerLayout as MarkerLayout
from taccel_lab.signals.normals import normals_from_height as normals_from_height
from taccel_lab.signals.normals import normals_from_slopes as normals_from_slopes
from taccel_lab.signals.tactile import SignalTactile as SignalTactile
