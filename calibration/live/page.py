# SPDX-License-Identifier: Apache-2.0
"""The page of a live session: all that is read, its figures, and how long it takes."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from taccel_lab.calibration.live.latency import Latency
from taccel_lab.calibration.live.pictures import StripChart, pictures
from taccel_lab.calibration.live.reader import LiveReader, LiveReading
from taccel_lab.calibration.pressure.reading_files import write_reading
from taccel_lab.calibration.pressure.touch import TouchReading
from taccel_lab.calibration.record.tiles import show_tiles, wide_panel
from taccel_lab.files.atomic_file import write_image
from taccel_lab.report.page_text import PageText, add_note, page_table

if TYPE_CHECKING:
    import numpy as np
    from viser import GuiApi, ViserServer

FIGURES_EVERY_S = 0.25
STAGES = {"wait": "wait for camera", "frame": "crop", "age": "taken to shown"}
"""Stages whose short name says too little."""
SPREAD = " +-"
"""Ends the name of a standard deviation, before its unit."""


class LiveSheet:
    """The pictures of all sensors of a page, and its button to stop."""

    def __init__(self, server: ViserServer) -> None:
        self.server = server
        self.stop = threading.Event()
        self._pictures: dict[str, list[tuple[str, np.ndarray]]] = {}
        wide_panel(server)
        server.gui.add_button("Stop").on_click(lambda _: self.stop.set())

    def show(self, name: str, pictures: list[tuple[str, np.ndarray]]) -> None:
        """Show a sensor's pictures beside those of the others, in the order of the names."""
        self._pictures[name] = pictures
        several = len(self._pictures) > 1
        shown = [
            (f"{of}: {title}" if several else title, picture)
            for of, own in sorted(self._pictures.items())
            for title, picture in own
        ]
        show_tiles(self.server, shown)


class LivePage:
    """A ``LiveWatcher`` in the browser."""

    def __init__(
        self, sheet: LiveSheet, pictures_hz: float, snapshots: Path, name: str = ""
    ) -> None:
        """Pictures are drawn at most ``pictures_hz`` times a second; ``name``: of the sensor, where
        the page has several."""
        self._sheet, self._name = sheet, name
        self._every_s = 1.0 / pictures_hz
        self._drawn_s = self._shown_s = float("-inf")
        self._again, self._keep = threading.Event(), threading.Event()
        self._snapshots = snapshots
        gui = sheet.server.gui
        with gui.add_folder(name) if name else nullcontext():
            self._fill(gui)

    def _fill(self, gui: GuiApi) -> None:
        self._prompt = add_note(gui)
        self._figures = add_note(gui)
        gui.add_button("Take the untouched gel again").on_click(lambda _: self._again.set())
        gui.add_button("Snapshot").on_click(lambda _: self._keep.set())
        self._kept = add_note(gui)
        self._chart = StripChart(gui)
        self._latency = add_note(gui)

    def show(self, reading: LiveReading, reader: LiveReader, latency: Latency) -> None:
        """Draw a reading, unless the last one was drawn just now."""
        now = time.monotonic()
        self._chart.add(now, reading)
        if self._keep.is_set():
            self._keep.clear()
            kept = save_snapshot(reading, reader, self._snapshots)
            self._kept.content = PageText("wrote {}").format(str(kept))
        if now - self._drawn_s >= self._every_s:
            self._drawn_s = now
            self._sheet.show(self._name, pictures(reading, reader.background))
        if now - self._shown_s >= FIGURES_EVERY_S:
            self._shown_s = now
            self._figures.content = figures_text(reading, reader)
            self._latency.content = latency_text(latency, reader)
            self._chart.draw()

    def tell(self, text: str) -> None:
        """Say what to do, in bold."""
        self._prompt.content = PageText("**{}**").format(text) if text else ""

    def wants_background(self) -> bool:
        """Whether the button was pressed since the last call."""
        wanted = self._again.is_set()
        self._again.clear()
        return wanted

    def stopped(self) -> bool:
        """Whether the button was pressed."""
        return self._sheet.stop.is_set()


def figures_text(reading: LiveReading, reader: LiveReader) -> PageText:
    """What the reading says, in Markdown."""
    lines: list[str] = []
    figures = reading.figures
    if reading.refused:
        lines.append(PageText("## no depth\n\n{}").format(reading.refused))
    elif figures:
        sigma = figures["max_depth_sigma_mm"]
        band = "" if sigma is None else f" ± {sigma:.3f}"
        deep = PageText("## {:.3f}{} mm deep")
        lines.append(deep.format(figures["max_depth_mm"], band))
        x, y = figures["deepest_gel_mm"]
        lines.append(f"at ({x:.2f}, {y:.2f}) mm, {figures['touched_mm2']:.1f} mm² touched")
        lines += [PageText("*{}*").format(text) for text in figures["warnings"]]
    if reading.press is not None:
        press = reading.press
        words = PageText("normal force **{}**, by the contact of an elastic layer; {} mm² touch")
        lines.append(words.format(press.force_words, f"{press.contact_mm2:.1f}"))
        lines += [PageText("*{}*").format(text) for text in press.remarks]
    elif reader.no_pressure:
        lines.append(PageText("{}").format(reader.no_pressure))
    if reading.markers_px is not None and reading.seen is not None and reading.rest_px is not None:
        moved = reading.markers_px - reading.rest_px
        largest = float((moved**2).sum(axis=1).max() ** 0.5)
        lines.append(
            f"{int(reading.seen.sum())} of {len(reading.seen)} markers seen, largest displacement "
            f"{largest:.1f} px"
        )
    elif reader.no_markers:
        lines.append(f"markers are not followed: {reader.no_markers}")
    lines += _force_lines(reading.forces)
    if reader.force is None:
        lines.append("shear is not read: the profile has no force model (calibrate force)")
    elif not reading.forces:
        lines.append("no force: this frame is not like those that the force model knows")
    return PageText("\n\n").join(lines)


def _force_lines(forces: Mapping[str, float]) -> list[PageText]:
    """A line for each force, ``Fz +- [N]`` behind the ``Fz [N]`` that it belongs to."""
    lines = []
    for name, value in forces.items():
        quantity, _, unit = name.partition(" [")
        if quantity.endswith(SPREAD):
            continue
        spread = forces.get(f"{quantity}{SPREAD} [{unit}")
        band = "" if spread is None else f" ± {spread:.2f}"
        line = PageText("{}: **{:.2f}{}** {}")
        lines.append(line.format(quantity, value, band, unit.removesuffix("]")).rstrip())
    return lines


def latency_text(latency: Latency, reader: LiveReader) -> PageText:
    """Times by stage, as a table in Markdown."""
    found = latency.figures()
    if not found["frames"]:
        return PageText()
    rows = [("all work", found["busy_ms"]), *found["stages_ms"].items()]
    table = [
        (STAGES.get(name, name), f"{ms['median']:.1f}", f"{ms['p95']:.1f}")
        for name, ms in rows
        if ms
    ]
    grid = reader.grid
    head = PageText("**{:.1f} frames a second**, depth on {}x{} px\n\n")
    return head.format(found["rate_hz"], grid.width_px, grid.height_px) + page_table(
        table, ("stage [ms]", "median", "95 %")
    )


_SNAPSHOT = re.compile(r"snapshot_(\d+)_image\.png")


def save_snapshot(reading: LiveReading, reader: LiveReader, folder: Path) -> Path:
    """Write ``snapshot_N_image.png``, and the files of ``taccel-lab depth`` where the depth is not
    refused; returns the image's path. Nothing is overwritten: N is the next that is free."""
    folder.mkdir(parents=True, exist_ok=True)
    taken = [int(found[1]) for p in folder.iterdir() if (found := _SNAPSHOT.fullmatch(p.name))]
    stem = f"snapshot_{max(taken, default=-1) + 1:03d}"
    path = folder / f"{stem}_image.png"
    write_image(path, reading.image)
    if reading.surface is not None and not reading.refused:
        touch = TouchReading(
            **vars(reading.surface),
            grid=reader.grid,
            press=reading.press,
            no_press=reader.no_pressure,
        )
        write_reading(touch, reading.image, path, folder, stem)
    return path
