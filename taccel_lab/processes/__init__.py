# SPDX-License-Identifier: Apache-2.0
"""Python processes of our own: one, pools of them, and Warp started in each."""
