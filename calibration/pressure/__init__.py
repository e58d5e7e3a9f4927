# SPDX-License-Identifier: Apache-2.0
"""Pressure and force from the surface that one image shows, by the contact of an elastic layer."""
