# SPDX-License-Identifier: Apache-2.0
"""An existing profile, corrected for the light of today."""
