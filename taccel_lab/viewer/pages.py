# SPDX-License-Identifier: Apache-2.0
"""Opens the page of a source and keeps it open."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from taccel_lab.report.live_page import PageOptions, live_page, serve_until_stopped
from taccel_lab.viewer.sources import Kind, Source

if TYPE_CHECKING:
    from viser import ViserServer


@contextmanager
def source_page(
    source: Source,
    options: PageOptions,
    say: Callable[[str], None] | None = None,
    *,
    seed: int = 0,
    device: str = "cpu",
) -> Iterator[ViserServer]:
    """The page of a source while the block runs.

    Args:
        source: Of ``find_source``.
        options: Where it is served.
        say: Told the address.
        seed: Start of a live task.
        device: Warp device of a live task.

    Raises:
        InputError: Files that are not as they should be, or as of ``live_page``.
    """
    read = _read(source)  # What cannot be read is rejected before a page opens.
    title = f"{source.kind}: {source.path.name or source.name}"
    with live_page(title, options, say) as server:
        close = _fill(server, source, read, seed, device)
        try:
            yield server
        finally:
            if close is not None:
                close()


def serve_source(
    source: Source,
    options: PageOptions,
    say: Callable[[str], None],
    *,
    seed: int = 0,
    device: str = "cpu",
    stop: threading.Event | None = None,
) -> None:
    """As ``source_page``, until KeyboardInterrupt or ``stop``."""
    with source_page(source, options, say, seed=seed, device=device):
        serve_until_stopped(stop)


def _read(source: Source) -> Any:
    if source.kind is Kind.PROFILE:
        from taccel_lab.sensors.profile import stock_sensor

        return stock_sensor(source.name)
    if source.kind is Kind.DATASET:
        from taccel_lab.viewer.dataset_page import open_dataset

        return open_dataset([source.path])
    if source.kind is Kind.TASK:
        from taccel_lab.tasks.catalogue import named, read_task

        return read_task(source.path) if source.path.is_file() else named(source.name)
    if source.kind is Kind.PRESS:
        from taccel_lab.viewer.press_folder import read_press

        return read_press(source.path)
    return None


def _fill(
    server: ViserServer, source: Source, read: Any, seed: int, device: str
) -> Callable[[], None] | None:
    """Fill the page; returns what ends its threads."""
    if source.kind is Kind.PROFILE:
        from taccel_lab.viewer.profile_page import fill_profile_page

        fill_profile_page(server, read)
    elif source.kind is Kind.PRESS:
        from taccel_lab.viewer.press_folder import fill_press_page

        fill_press_page(server, source.path, read)
    elif source.kind is Kind.STUDY:
        from taccel_lab.viewer.study_page import StudyPage

        StudyPage(server, source.path)
    elif source.kind is Kind.DATASET:
        from taccel_lab.viewer.dataset_page import DatasetPage

        DatasetPage(server, read)
    elif source.kind is Kind.REPLAY:
        from taccel_lab.viewer.live_scene import fill_replay_page

        fill_replay_page(server, source.path)
    else:
        from taccel_lab.viewer.live_scene import LiveScene

        title = f"{read.name}, seed {seed}"
        return LiveScene(server, title, lambda: read.begin([seed], device)).close
    return None
