# SPDX-License-Identifier: Apache-2.0
# Untyped on purpose, see warp/__init__.pyi.
from typing import Any

def __getattr__(name: str) -> Any: ...
