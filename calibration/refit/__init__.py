# SPDX-License-Identifier: Apache-2.0
"""An old profile brought to the light of today."""
