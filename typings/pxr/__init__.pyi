"""Of usd-core, whose modules state no types."""

from typing import Any

Sdf: Any
UsdUtils: Any
