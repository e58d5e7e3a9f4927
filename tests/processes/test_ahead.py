# SPDX-License-Identifier: Apache-2.0
"""Work ahead in threads: in order, a few items at a time, errors where they belong."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from taccel_lab.processes.ahead import ahead


@pytest.fixture(params=[1, 3])
def cores(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("taccel_lab.processes.ahead.usable_cores", lambda: request.param)
    return request.param


def test_results_come_in_order_and_items_are_taken_as_they_are_needed(cores: int) -> None:
    taken = []

    def items() -> Iterator[int]:
        for item in range(50):
            taken.append(item)
            yield item

    results = ahead(lambda item: item**2, items())
    assert next(results) == 0 and len(taken) <= 2 * cores + 1
    assert list(results) == [item**2 for item in range(1, 50)]
    assert list(ahead(str, [])) == []


def test_later_items_are_worked_on_while_an_earlier_one_lasts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("taccel_lab.processes.ahead.usable_cores", lambda: 2)
    second = threading.Event()

    def work(item: int) -> int:
        if item == 0:
            assert second.wait(30)
        else:
            second.set()
        return item

    assert list(ahead(work, range(2))) == [0, 1]


@pytest.mark.usefixtures("cores")
def test_an_error_comes_where_its_result_would() -> None:
    results = ahead(lambda item: 1 / item, [1, 2, 0, 4])
    assert [next(results), next(results)] == [1.0, 0.5]
    with pytest.raises(ZeroDivisionError):
        next(results)
