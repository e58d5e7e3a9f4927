# SPDX-License-Identifier: Apache-2.0
"""Scalars of a training as TensorBoard reads them, beside what the training itself writes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from taccel_lab.errors import InputError

Scalars = Callable[[Mapping[str, float], int], None]
"""Takes values by name, and the step that they belong to."""


def unwritten(values: Mapping[str, float], step: int) -> None:
    """Write nothing."""


@contextmanager
def scalars_in(folder: Path | None) -> Iterator[Scalars]:
    """Write scalars into a folder while the block runs; nowhere when it is None.

    Raises:
        InputError: tensorboard is not installed, or the folder cannot be written.
    """
    if folder is None:
        yield unwritten
        return
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise InputError(
            "scalars are written by tensorboard, which is not installed: "
            "pip install 'taccel-lab[tensorboard]'"
        ) from None
    try:
        writer = SummaryWriter(str(folder))
    except OSError as error:
        raise InputError(f"{folder} cannot be written: {error.strerror}") from None

    def write(values: Mapping[str, float], step: int) -> None:
        for name, value in values.items():
            writer.add_scalar(name, value, step)
        writer.flush()  # A curve is looked at while it grows.

    with writer:
        yield write
