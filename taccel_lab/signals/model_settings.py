# SPDX-License-Identifier: Apache-2.0
"""Settings of the small networks as a profile stores them: exact keys, right types."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from taccel_lab.errors import InputError


def settings_dict(config: Any) -> dict[str, Any]:
    """The fields of a dataclass as a flat dict of numbers, strings and lists."""
    return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(config).items()}


@contextmanager
def reading_settings(
    model: str, fields: Iterable[str], values: Mapping[str, Any]
) -> Iterator[None]:
    """Refuse unknown and missing keys, and values whose conversion fails inside the block."""
    fields = list(fields)
    unknown, missing = set(values) - set(fields), set(fields) - set(values)
    if unknown or missing:
        raise InputError(
            f"{model} settings: unknown {sorted(unknown)}, missing {sorted(missing)}; "
            f"exactly {', '.join(fields)} are allowed"
        )
    try:
        yield
    except InputError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"{model} settings hold a value of a wrong type: {error}") from None
