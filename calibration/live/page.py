# SPDX-License-Identifier: Apache-2.0
"""The page of a live session: all that is read, its figures, and how long it takes.

Pictures are drawn fast: no axes, one colour scale with its numbers a map.
"""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from taccel_lab.calibration.live.reader import LiveReader, LiveReading, SeenMarkers
from taccel_lab.calibration.live.run import Latency
from taccel_lab.calibration.live.surface_view import SurfaceView
from taccel_lab.calibration.record.page import show_tiles, wide_panel
from taccel_lab.files.atomic_file import parents_made, write_image
from taccel_lab.reading.reading import Reading
from taccel_lab.report.page_text import PageText, add_note, page_table

if TYPE_CHECKING:
    import numpy as np
    from viser import GuiApi, ViserServer

LEAST_DEEPEST_MM = 0.3
"""The colour scale of the depth ends here at least, so that noise stays dark."""
BEYOND = (225, 60, 160)
"""Pixels beyond the calibration."""
REFUSED = 170
LEAST_PRESSURE_KPA = 10.0
"""The colour scale of the pressure ends here at least."""
PAPER, INK = 250, (60, 60, 60)
ARROWS = 3.0
"""Times the markers' displacement."""


def pictures(reading: LiveReading, background: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Title and RGB uint8 picture of all that was read."""
    change = reading.image.astype(np.int16) - background.astype(np.int16)
    shown = [
        ("camera", reading.image),
        ("change", np.clip(128 + 2 * change, 0, 255).astype(np.uint8)),
    ]
    found = reading.reading
    if found is not None:
        normals = np.clip(127.5 * (found.normals + 1.0), 0, 255).astype(np.uint8)
        shown += [depth_picture(found), ("normals", normals)]
        if found.press is not None:
            kpa = found.pressure_kpa
            high = max(float(kpa.max()), LEAST_PRESSURE_KPA)
            shown.append(("pressure [kPa]", _colored_map(kpa, high, cv2.COLORMAP_INFERNO)))
    elif reading.refused:
        grey = np.full(reading.image.shape, REFUSED, np.uint8)
        shown.append(("depth: the frame is refused", grey))
    if reading.markers is not None:
        shown.append((f"markers, arrows x{ARROWS:g}", _markers(reading.image, reading.markers)))
    return shown


def depth_picture(found: Reading) -> tuple[str, np.ndarray]:
    """Title, and the depth in colours; what the calibration does not reach is marked."""
    marked, high_mm = (found.beyond_balls, found.saturated), max(found.depth_mm, LEAST_DEEPEST_MM)
    picture = _colored_map(1e3 * found.depth_m, high_mm, cv2.COLORMAP_VIRIDIS, marked)
    return "depth [mm] (pink: beyond the calibration)", picture


def _colored(levels: np.ndarray, colors: int) -> np.ndarray:
    return cv2.cvtColor(cv2.applyColorMap(levels, colors), cv2.COLOR_BGR2RGB)


def _colored_map(
    values: np.ndarray, high: float, colors: int, marked: Sequence[np.ndarray | None] = ()
) -> np.ndarray:
    """Values from 0 to ``high`` in colours, with their bar on the right; ``marked`` pixels are
    pink."""
    picture = _colored(np.clip(255 * values / high, 0, 255).astype(np.uint8), colors)
    for pixels in marked:
        if pixels is not None:
            picture[pixels] = BEYOND
    height = picture.shape[0]
    text = max(0.3, height / 600)
    wide = max(6, height // 24)
    bar = np.full((height, wide + round(110 * text), 3), PAPER, np.uint8)
    levels = np.linspace(255, 0, height).astype(np.uint8)[:, None]
    bar[:, 2 : 2 + wide] = _colored(np.repeat(levels, wide, axis=1), colors)
    digits = 0 if high >= 20 else 2
    for share in (0.0, 0.5, 1.0):
        row = round((1 - share) * (height - 1))
        where = (wide + 6, min(max(row + round(10 * text), round(24 * text)), height - 2))
        label = f"{share * high:.{digits}f}"
        cv2.putText(bar, label, where, cv2.FONT_HERSHEY_SIMPLEX, text, INK, 1, cv2.LINE_AA)
    return np.hstack([picture, bar])


def _markers(image: np.ndarray, markers: SeenMarkers) -> np.ndarray:
    picture = image.copy()
    for place, rest, seen in zip(markers.uv_px, markers.rest_px, markers.seen, strict=True):
        if not np.isfinite(place).all():
            continue
        tip = rest + ARROWS * (place - rest)
        color = (255, 220, 0) if seen else (160, 160, 160)
        ends = [(round(float(u)), round(float(v))) for u, v in (rest, tip)]
        cv2.arrowedLine(picture, ends[0], ends[1], color, 1, cv2.LINE_AA, tipLength=0.3)
    return picture


SECONDS = 30.0
MOST_POINTS = 600
CURVES = (
    ("depth [mm]", "depth_mm", "#1f77b4"),
    ("area [mm²]", "area_mm2", "#2ca02c"),
    ("normal force [N]", "force_n", "#d62728"),
)
"""Label, name in a reading, colour."""


class StripChart:
    """Three curves over one time."""

    def __init__(self, gui: GuiApi) -> None:
        """Put the chart below what the page has so far."""
        from viser import uplot

        self._rows: deque[tuple[float, ...]] = deque()
        empty = np.zeros(1), np.zeros(1)
        self._plots = [
            gui.add_uplot(
                data=empty,
                series=(uplot.Series(label="s"), uplot.Series(label=label, stroke=color, width=2)),
                scales={"x": uplot.Scale(time=False)},
                title=label,
                aspect=3.5,
            )
            for label, _, color in CURVES
        ]

    def add(self, now_s: float, reading: LiveReading) -> None:
        """Take a reading in; what it does not tell is a gap."""
        values = (
            getattr(part, name, np.nan)
            for part, (_, name, _) in zip(
                (reading.reading, reading.press, reading.press), CURVES, strict=True
            )
        )
        self._rows.append((now_s, *values))
        while now_s - self._rows[0][0] > SECONDS:
            self._rows.popleft()

    def draw(self) -> None:
        """Show what was taken in."""
        rows = np.array(list(self._rows)[:: 1 + len(self._rows) // MOST_POINTS])
        past_s = rows[:, 0] - rows[-1, 0]
        for plot, values in zip(self._plots, rows.T[1:], strict=True):
            plot.data = past_s, values


FIGURES_EVERY_S = 0.25
STAGES = {"wait": "wait for camera", "frame": "whole, and ours", "age": "taken to shown"}
"""Stages whose short name says too little."""
SPREAD = " +-"
"""Ends the name of a standard deviation, before its unit; in words it stands before one."""


VIEWS = ("pictures", "3D")
RELIEF = 5.0
"""Times by which heights are drawn in 3D at first: dents are a hundredth of a gel's width."""


class LiveSheet:
    """The pictures or surfaces of all sensors of a page, and its button to stop."""

    def __init__(self, server: ViserServer) -> None:
        self.server = server
        self.stop = threading.Event()
        self._pictures: dict[str, list[tuple[str, np.ndarray]]] = {}
        self._last: dict[str, tuple[LiveReading, np.ndarray]] = {}
        self._showing = threading.Lock()
        self._surfaces = SurfaceView(server)
        wide_panel(server)
        server.gui.add_button("Stop").on_click(lambda _: self.stop.set())
        self._view = server.gui.add_button_group("Show", VIEWS)
        self._relief = server.gui.add_slider(
            "Heights, times", 1.0, 20.0, 1.0, RELIEF, visible=False
        )
        self._scale = add_note(server.gui)
        self._view.on_click(lambda _: self._choose())

    def _choose(self) -> None:
        self._relief.visible = self._in_space
        # The next frame may be long in coming.
        for name, last in list(self._last.items()):
            self.show(name, *last)

    @property
    def _in_space(self) -> bool:
        return self._view.value == VIEWS[1]

    def show(self, name: str, reading: LiveReading, background: np.ndarray) -> None:
        """Show what a sensor reads beside the others, in the order of the names."""
        with self._showing:
            self._last[name] = reading, background
            self._show(name, reading, background)

    def _show(self, name: str, reading: LiveReading, background: np.ndarray) -> None:
        if not self._in_space:
            self._show_pictures(name, pictures(reading, background))
        elif reading.reading is None and not reading.refused:
            self._scale.content = PageText("{} reads no depth").format(name or "this profile")
        else:
            deepest_mm = self._surfaces.show(
                name, reading.reading, relief=self._relief.value, least_mm=LEAST_DEEPEST_MM
            )
            colors = PageText("depth from 0 (violet) to {:.2f} mm (yellow)")
            self._scale.content = (
                "depth: the frame is refused" if reading.refused else colors.format(deepest_mm)
            )

    def _show_pictures(self, name: str, pictures: list[tuple[str, np.ndarray]]) -> None:
        if self._surfaces.hide():
            self._scale.content = ""
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
        self._drawing, self._settling = threading.Lock(), threading.Timer(0.0, lambda: None)
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
        """Draw a reading, unless the last one was drawn just now; one that no other follows is
        drawn a moment later."""
        now = time.monotonic()
        self._settling.cancel()
        self._chart.add(now, reading)
        if self._keep.is_set():
            self._keep.clear()
            kept = save_snapshot(reading, self._snapshots)
            self._kept.content = PageText("wrote {}").format(str(kept))
        pictures = now - self._drawn_s >= self._every_s
        figures = now - self._shown_s >= FIGURES_EVERY_S
        self._draw(reading, reader, latency, pictures, figures)
        if not (pictures and figures):
            shown = reading, reader, latency, not pictures, not figures
            self._settling = threading.Timer(FIGURES_EVERY_S, self._draw, shown)
            self._settling.daemon = True
            self._settling.start()

    def _draw(
        self,
        reading: LiveReading,
        reader: LiveReader,
        latency: Latency,
        pictures: bool,
        figures: bool,
    ) -> None:
        with self._drawing:
            if pictures:
                self._drawn_s = time.monotonic()
                self._sheet.show(self._name, reading, reader.background)
            if figures:
                self._shown_s = time.monotonic()
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
    if reading.refused:
        lines.append(PageText("## no depth\n\n{}").format(reading.refused))
    elif (found := reading.reading) is not None:
        depth, *pressed = (words.replace(SPREAD, " ±") for words in found.words)
        lines.append(PageText("## {}").format(depth))
        lines += [PageText("**{}**").format(text) for text in pressed]
        # What the profile says of itself stands above.
        told = reader.profile.sensor.provenance.remarks
        lines += [PageText("*{}*").format(text) for text in found.notes if text not in told]
    if reading.markers is not None:
        seen, moved = reading.markers.seen, reading.markers.uv_px - reading.markers.rest_px
        largest = float((moved[seen] ** 2).sum(axis=1).max(initial=0.0) ** 0.5)
        unread = reading.markers.unread and f"; this frame is not read, {reading.markers.unread}"
        lines.append(
            f"{int(seen.sum())} of {len(seen)} markers seen, largest displacement {largest:.1f} px"
            + unread
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
    rows = [("all work", found["busy_ms"]), ("of a core", found["cpu_ms"])]
    rows += found["stages_ms"].items()
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


_SNAPSHOT = re.compile(r"snapshot_(\d+)[._].+")


def save_snapshot(reading: LiveReading, folder: Path) -> Path:
    """Write ``snapshot_N_image.png``, and the files of ``taccel-lab depth --ply`` where the depth
    is not refused; returns the image's path. Nothing is overwritten: N is the next that is free."""
    taken = [int(found[1]) for p in folder.glob("*") if (found := _SNAPSHOT.fullmatch(p.name))]
    stem = f"snapshot_{max(taken, default=-1) + 1:03d}"
    path = folder / f"{stem}_image.png"
    with parents_made(path):
        try:
            write_image(path, reading.image)
            if reading.reading is not None:
                replace(reading.reading, name=str(path)).write_into(folder, stem, ply=True)
        except Exception:
            for left in folder.glob(f"{stem}[._]*"):
                left.unlink()
            raise
    return path
