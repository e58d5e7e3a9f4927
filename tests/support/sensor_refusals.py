# SPDX-License-Identifier: Apache-2.0
"""Tables of what sensors, pads, profiles and robots refuse, as tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from taccel_lab.errors import InputError


def refuses(call: Callable[..., object], *rows: Any, given: str = "") -> Callable[..., None]:
    """A test with a case for each row: arguments, and what the InputError of ``call`` says.

    ``given`` names a fixture that is the first argument.
    """

    @pytest.mark.parametrize("row", rows)
    def test(row: Any, request: pytest.FixtureRequest) -> None:
        *arguments, words = row
        first = [request.getfixturevalue(given)] if given else []
        with pytest.raises(InputError, match=words):
            call(*first, *arguments)

    return test
