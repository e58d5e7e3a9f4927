# SPDX-License-Identifier: Apache-2.0
"""A sensor seen live through its profile: depth, normals and markers of every frame."""
