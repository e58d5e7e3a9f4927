# SPDX-License-Identifier: Apache-2.0
"""Linear algebra of small arrays in one thread, on any number of cores.

Threads of BLAS that wait for each other take up to thirty times as long over a few hundred numbers,
and add them up in another order: what is made of them would then depend on the machine's cores.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class _Limit:
    """Of this process, for as long as any of its threads asks for it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._asked = 0
        self._limits: Any = None

    def take(self) -> None:
        from threadpoolctl import threadpool_limits

        with self._lock:
            if self._asked == 0:
                self._limits = threadpool_limits(1, user_api="blas")
            self._asked += 1

    def leave(self) -> None:
        with self._lock:
            self._asked -= 1
            if self._asked == 0:
                self._limits.restore_original_limits()


_limit = _Limit()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Have the BLAS of the libraries that are loaded run in one thread meanwhile; where several
    threads of this process ask for it, until the last one is through."""
    _limit.take()
    try:
        yield
    finally:
        _limit.leave()
