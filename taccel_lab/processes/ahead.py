# SPDX-License-Identifier: Apache-2.0
"""Work on the next items in threads, while this one uses the results, in order.

For work that spends its time in libraries which let other threads run meanwhile (FFTs, matrix
products, filters of pictures): it needs no process, which would load them anew and take copies.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from taccel_lab.processes.process_pool import usable_cores

Item = TypeVar("Item")
Result = TypeVar("Result")


def ahead(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Results of ``work`` in the order of the items, a thread a core.

    Items are taken one after the other by who asks for results, so that they may be drawn from one
    generator of random numbers. At most two results a core wait to be used.
    """
    cores = usable_cores()
    if cores == 1:
        yield from map(work, items)
        return
    waiting: deque[Future[Result]] = deque()
    pool = ThreadPoolExecutor(cores)
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > 2 * cores:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
