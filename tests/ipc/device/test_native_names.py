# SPDX-License-Identifier: Apache-2.0
"""What our C++ takes of Warp's own: these names and no others, with these meanings.

Warp does not promise them. A version that renames one fails here, by name, before a kernel does.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import warp as wp

PACKAGE = Path(__file__).parents[3] / "taccel_lab"
INTERFACE = {
    "WP_TILE_BLOCK_DIM", "WP_TILE_SYNC",
    "wp::address", "wp::cross", "wp::dot", "wp::float32", "wp::float64", "wp::int32", "wp::mat_t",
    "wp::sqrt", "wp::uint64", "wp::vec_t", ".data", ".shape",
}  # fmt: skip
_NAMES = re.compile(r"\bwp::\w+|\bWP_\w+|(?<=\w)\.(?:data|shape|strides|ndim|grad)\b")


def snippets() -> Iterator[str]:
    """All C++ of the package: that of the folder, and what is a line or two."""
    for path in sorted((PACKAGE / "ipc" / "device" / "native").glob("*.cpp")):
        yield path.read_text(encoding="utf-8")
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if "func_native" in text:
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    if ";" in node.value and re.search(r"[{}]|\);", node.value):
                        yield node.value


def test_no_other_names_are_used() -> None:
    assert {name for text in snippets() for name in _NAMES.findall(text)} == INTERFACE


@wp.func_native("""
    const wp::int32 width = values.shape[1];
    const wp::uint64 first = static_cast<wp::uint64>(row) * width;
    wp::mat_t<3, 3, wp::float64> rows;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            rows.data[i][j] = values.data[first + 3 * i + j];
    const wp::vec_t<3, wp::float64> a(rows.data[0][0], rows.data[0][1], rows.data[0][2]);
    wp::vec_t<3, wp::float64> b;
    for (int j = 0; j < 3; ++j)
        b[j] = rows.data[1][j];
    const wp::vec_t<2, wp::float32> both(1.5f, 2.0f);
    WP_TILE_SYNC();
    *wp::address(result, row) = wp::dot(wp::cross(a, b), a + b) + wp::sqrt(rows.data[2][2])
        + (WP_TILE_BLOCK_DIM > 0 ? both[0] * both[1] : 0.0);
""")
def _all_names(
    row: int, values: wp.array2d(dtype=wp.float64), result: wp.array(dtype=wp.float64)
) -> None: ...


@wp.kernel
def _kernel(values: wp.array2d(dtype=wp.float64), result: wp.array(dtype=wp.float64)) -> None:
    _all_names(wp.tid(), values, result)


def test_this_version_of_warp_has_them() -> None:
    values = np.random.default_rng(0).uniform(1.0, 2.0, (4, 9))
    result = wp.zeros(4, dtype=wp.float64, device="cpu")
    wp.launch(_kernel, 4, [wp.array(values, dtype=wp.float64, device="cpu"), result], device="cpu")
    # A vector product is upright on its factors.
    assert np.allclose(result.numpy(), np.sqrt(values[:, 8]) + 3.0, rtol=1e-12)
