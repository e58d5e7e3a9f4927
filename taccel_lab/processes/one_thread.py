# SPDX-License-Identifier: Apache-2.0
"""Linear algebra of small arrays in one thread, on any number of cores.

Threads of BLAS that wait for each other take up to thirty times as long over a few hundred numbers,
and add them up in another order: what is made of them would then depend on the machine's cores.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Have the BLAS of the libraries that are loaded run in one thread meanwhile."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield
