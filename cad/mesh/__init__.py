# SPDX-License-Identifier: Apache-2.0
"""Tet meshes of parts: structured and free-form meshers, quality, regions and a cache."""
