# SPDX-License-Identifier: Apache-2.0
"""Fixed-size FP64 matrix types of a contact stencil of four nodes (12 degrees of freedom).

Row and column `3 i + a` of a 12x12 matrix belongs to coordinate `a` of stencil node `i`; row `i` of
a 4x3 matrix is the 3-vector of node `i`.
"""

from __future__ import annotations

import warp as wp

mat23d = wp.types.matrix(shape=(2, 3), dtype=wp.float64)
mat43d = wp.types.matrix(shape=(4, 3), dtype=wp.float64)
mat1212d = wp.types.matrix(shape=(12, 12), dtype=wp.float64)
