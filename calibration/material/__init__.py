# SPDX-License-Identifier: Apache-2.0
"""The gel's material from forces and motions: stiffness, Poisson's ratio, friction, relaxation."""
