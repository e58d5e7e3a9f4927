# SPDX-License-Identifier: Apache-2.0
"""Affine bodies: embedding of surface vertices, stiffness against deformation."""
