# SPDX-License-Identifier: Apache-2.0
"""Tet meshes of parts: structured and free-form meshers, quality, regions and a cache."""

from taccel_lab.cad.mesh.even import even_gel_mesh
from taccel_lab.cad.mesh.structured import structured_gel_mesh

__all__ = ["even_gel_mesh", "structured_gel_mesh"]
