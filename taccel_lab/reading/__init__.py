# SPDX-License-Identifier: Apache-2.0
"""An image in; surface, touch, pressure, force and what they may be off by out."""
