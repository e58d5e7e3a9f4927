# SPDX-License-Identifier: Apache-2.0
"""Grey sensors: from how far a pixel darkens to how deep the gel is pressed there."""
