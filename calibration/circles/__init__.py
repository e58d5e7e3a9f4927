# SPDX-License-Identifier: Apache-2.0
"""Contact circles of ball presses: found, refined, held against labels, fused with them."""
