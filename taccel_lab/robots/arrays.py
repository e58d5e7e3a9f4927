# SPDX-License-Identifier: Apache-2.0
"""Arrays of numpy or of torch, by what is given: the kinematics are written once for both.

Both have the names and the arguments of the Python array API standard that are used here
(https://data-apis.org/array-api). torch is not imported for it.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

Array = Any
"""A numpy array, or a tensor of torch on any device."""


def is_tensor(value: Any) -> bool:
    """Whether it is a tensor of torch."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


def namespace(value: Array) -> Any:
    """The module whose functions take it: torch for its tensors, else numpy."""
    return sys.modules["torch"] if is_tensor(value) else np


class Constants:
    """Arrays that stay as they are, copied once to each device that asks for them."""

    def __init__(self, arrays: Mapping[str, np.ndarray]) -> None:
        self._arrays = dict(arrays)
        self._copies: dict[Any, dict[str, Array]] = {}

    def beside(self, value: Array) -> dict[str, Array]:
        """They by name: of numpy, or tensors on the device of ``value``."""
        if not is_tensor(value):
            return self._arrays
        if value.device not in self._copies:
            xp = namespace(value)
            self._copies[value.device] = {
                name: xp.asarray(array, device=value.device) for name, array in self._arrays.items()
            }
        return self._copies[value.device]
