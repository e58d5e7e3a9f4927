# SPDX-License-Identifier: Apache-2.0
"""Conjugate gradients by thread blocks."""
