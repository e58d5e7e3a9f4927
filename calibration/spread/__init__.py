# SPDX-License-Identifier: Apache-2.0
"""How far units and days differ: the profile's ``perturbation`` block from measured spread."""
