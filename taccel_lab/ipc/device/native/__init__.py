# SPDX-License-Identifier: Apache-2.0
"""C++ that Warp's kernels call (``wp.func_native``): a file for each module or package with some.

A line ``//: NAME`` begins the body of the function of that name, or a part of several; ``@NAME@``
in it stands for a number or another part. Lanes of a block share memory and work there as Warp's
own language cannot say. What the code takes of Warp's own names is listed, and tested, in
``tests/ipc/device/test_native_names.py``.
"""

from __future__ import annotations

from pathlib import Path

_FOLDER = Path(__file__).parent


def native(file: str, name: str, **values: object) -> str:
    """Section ``name`` of ``file``, with ``values`` in place of their names."""
    text = (_FOLDER / f"{file}.cpp").read_text(encoding="utf-8")
    body = text.split(f"\n//: {name}\n")[1].split("\n//: ")[0]
    for key, value in values.items():
        body = body.replace(f"@{key}@", str(value))
    return f"\n{body}\n"
