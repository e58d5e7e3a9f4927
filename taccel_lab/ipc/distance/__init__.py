# SPDX-License-Identifier: Apache-2.0
"""Distances between points, edges and triangles with exact first and second derivatives."""
