# SPDX-License-Identifier: Apache-2.0
"""Dots in a picture: found, fitted, numbered on a lattice; of markers and of boards alike."""
