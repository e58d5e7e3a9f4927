# SPDX-License-Identifier: Apache-2.0
"""The image of the untouched sensor: an average of all frames in one light, its noise and dust."""
