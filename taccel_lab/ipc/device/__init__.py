# SPDX-License-Identifier: Apache-2.0
"""What device code is made of, without any physics: sums, lists, matrices, thread blocks."""
