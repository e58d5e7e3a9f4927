# SPDX-License-Identifier: Apache-2.0
"""A recorded sequence read frame by frame: a table, and curves over time.

Rows are kept beside the output as they are read, so that the same call goes on after a kill.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.capture.camera.recording import Recording
from taccel_lab.calibration.live.reader import LiveReader, LiveReading
from taccel_lab.errors import InputError, keeping
from taccel_lab.files.atomic_file import (
    content_id,
    errors_named,
    parents_made,
    write_bytes,
    write_json,
)
from taccel_lab.files.growing_file import growing_file
from taccel_lab.files.inner_path import own_place
from taccel_lab.files.output_folder import atomic_directory, require_replaceable
from taccel_lab.files.videos import RecordedFrame
from taccel_lab.progress import Progress, silent
from taccel_lab.report.style import BLUE, LIGHT, in_report_style, new_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS: tuple[str, ...] = (
    "frame",
    "name",
    "time_s",
    "depth_mm",
    "depth_error_mm",
    "area_mm2",
    "force_n",
    "force_low_n",
    "force_high_n",
    "max_pressure_kpa",
    "center_x_mm",
    "center_y_mm",
    "markers_seen",
    "marker_mean_mm",
    "marker_largest_mm",
    "refused",
    "remarks",
)
"""Columns of a row; what a profile does not tell is empty. Force bounds are of the 95 % interval,
times since the first frame (of its episode, in a data set of several), remarks those of
``depth``."""
TEXTS = ("name", "refused", "remarks")
EPISODE_S = 1e7
"""Longer than any episode [s]."""
STUCK = (
    "the picture is that of the frame before, to the level: camera or recorder hung, or one frame "
    "was written twice; what is read is of that frame's time"
)
CURVES = (
    ("depth [mm]", "depth_mm", "depth_low_mm", "depth_high_mm"),
    ("area [mm2]", "area_mm2", "", ""),
    ("force [N]", "force_n", "force_low_n", "force_high_n"),
    ("markers moved, mean [mm]", "marker_mean_mm", "", ""),
)


def read_recorded(
    recording: Recording,
    reader: LiveReader,
    out: Path,
    recipe: dict[str, Any],
    progress: Progress = silent,
) -> list[dict[str, Any]]:
    """Write ``readings.csv``, ``readings.json`` and ``readings.png`` into ``out``; returns rows.

    Args:
        recording: The frames. Where their times are known, the force of a gel that relaxes follows
            from frame to frame; otherwise each frame is read by itself.
        reader: Of the profile and the untouched gel.
        out: Folder that appears whole at the end. Until then rows are kept in a hidden file beside.
        recipe: What the rows depend on; rows that were kept by another recipe are read again.
        progress: Told after each frame.

    Raises:
        InputError: No frame can be read.
    """
    require_replaceable(out)
    kept_path = own_place(out.parent, f".{out.name}.readings.jsonl")
    key = content_id(recipe)
    rows = _kept(kept_path, key)

    def what() -> str:
        if not rows:
            kept_path.unlink(missing_ok=True)
            return ""
        of = f"{len(rows)} of {recording.count()} frames"
        return f"rows of {of} stay in {kept_path}, and the same command goes on with them"

    with parents_made(out), keeping(what):
        try:
            with errors_named(kept_path, out):
                _read_further(recording, reader, rows, kept_path, key, progress)
            if all(row["refused"] for row in rows):
                refused = rows[0]["refused"]
                raise InputError(f"no frame of {recording.source} can be read: {refused}")
        except InputError:
            # The same command would end there again.
            rows.clear()
            raise
        _write(recording, rows, out)
    kept_path.unlink()
    return rows


def _read_further(
    recording: Recording,
    reader: LiveReader,
    rows: list[dict[str, Any]],
    kept_path: Path,
    key: str,
    progress: Progress,
) -> None:
    """Read the frames behind ``rows``: each one's row goes to the file that keeps them, then to
    ``rows``."""
    before, last = len(rows), None
    height, width = reader.background.shape[:2]
    frames = recording.frames((width, height))
    first = list(islice(frames, 1))  # Before they are counted, which takes long of a video.
    total = recording.count()
    with growing_file(kept_path) as kept:
        if not before:
            kept.truncate(0)
            kept.write(json.dumps({"key": key}) + "\n")
        for number, frame in enumerate(chain(first, frames)):
            image = frame.image if isinstance(frame.image, np.ndarray) else None
            stuck = image is not None and last is not None and np.array_equal(image, last)
            last = image
            if number < before:
                if reader.relaxes and frame.time_s is not None:
                    _row(reader, frame)  # Its force depends on the frames before.
                elif reader.tracker is not None and isinstance(frame.image, np.ndarray):
                    reader.tracker.advance(frame.image)  # Markers are followed, frame by frame.
                continue
            row = {"frame": number, "name": frame.name, "time_s": frame.time_s}
            row |= _row(reader, frame)
            if stuck:
                row["remarks"].append(STUCK)
            kept.write(json.dumps(row) + "\n")
            kept.flush()
            rows.append(row)
            progress("reading frames", number + 1, total)


def _write(recording: Recording, rows: list[dict[str, Any]], out: Path) -> None:
    with atomic_directory(out) as folder:
        (folder / "readings.csv").write_text(_table(rows), encoding="utf-8")
        write_json(
            folder / "readings.json",
            {
                "source": str(recording.source),
                "camera": recording.camera,
                "times_from": recording.times_from,
                "frames": rows,
            },
        )
        save_figure(draw_recorded(rows), folder / "readings.png")


def _table(rows: list[dict[str, Any]]) -> str:
    """Comma-separated values; texts are quoted, what is not known is empty (RFC 4180)."""

    def cell(value: Any) -> str:
        if isinstance(value, list):
            value = "; ".join(value)
        if isinstance(value, str) and value:
            return '"' + value.replace('"', '""') + '"'
        return "" if value is None else f"{value}"

    lines = [COLUMNS, *([cell(row.get(name)) for name in COLUMNS] for row in rows)]
    return "".join(",".join(line) + "\n" for line in lines)


def _kept(path: Path, key: str) -> list[dict[str, Any]]:
    """Rows that an interrupted call left, whose file then holds no others; none of another recipe
    or behind a torn line."""
    rows: list[dict[str, Any]] = []
    if not path.is_file():
        return rows
    text = path.read_text(encoding="utf-8", errors="replace")
    lines = text.rstrip("\n").split("\n")
    try:
        if json.loads(lines[0]) != {"key": key}:
            return []
        for number, line in enumerate(lines[1:]):
            row = json.loads(line)
            if row["frame"] != number or set(row) - set(COLUMNS):
                break
            rows.append(row)
    except (ValueError, IndexError, KeyError, TypeError):
        pass
    whole = [json.dumps({"key": key}), *map(json.dumps, rows)]
    sound = "".join(f"{line}\n" for line in whole)
    if sound != text:
        write_bytes(path, sound.encode())
    return rows


def _row(reader: LiveReader, frame: RecordedFrame) -> dict[str, Any]:
    image = frame.image
    if isinstance(image, InputError):
        return {"refused": str(image)}
    time_s = frame.time_s
    if time_s is not None:
        # Earlier than all frames of the episode before: what is followed begins anew.
        time_s -= EPISODE_S * frame.episode
    return figures_of(reader.read(image, time_s), reader)


def figures_of(reading: LiveReading, reader: LiveReader) -> dict[str, Any]:
    """The row of a reading, as of ``COLUMNS``."""
    found = reading.reading
    row: dict[str, Any] = {"refused": reading.refused, "remarks": [*(found.notes if found else ())]}
    if found is not None:
        row |= {"depth_mm": found.depth_mm, "depth_error_mm": found.depth_error_mm}
    if reading.press is not None:
        press = reading.press
        low, high = press.force_interval_n or (None, None)
        x, y = press.center_mm or (None, None)
        row |= {
            "area_mm2": press.area_mm2,
            "force_n": press.force_n,
            "force_low_n": low,
            "force_high_n": high,
            "max_pressure_kpa": 1e-3 * float(press.pressure_pa.max()),
            "center_x_mm": x,
            "center_y_mm": y,
        }
    if reading.markers is not None:
        grid, markers = reader.profile.grid(), reading.markers
        moved = (markers.uv_px - markers.rest_px) * [grid.mm_per_px_x, grid.mm_per_px_y]
        moved_mm = np.linalg.norm(moved[markers.seen], axis=1)
        row["markers_seen"] = len(moved_mm)
        if len(moved_mm):
            row |= {
                "marker_mean_mm": float(moved_mm.mean()),
                "marker_largest_mm": float(moved_mm.max()),
            }
    return row


def remarks_of(rows: list[dict[str, Any]]) -> list[tuple[str, int]]:
    """What readings say of themselves, and of how many frames. Remarks that differ in their numbers
    alone are one, told as of the first frame."""
    first: dict[str, str] = {}
    counts: Counter[str] = Counter()
    for row in rows:
        for remark in row.get("remarks", ()):
            kind = re.sub(r"[0-9]+([.][0-9]+)?", "#", remark)
            first.setdefault(kind, remark)
            counts[kind] += 1
    return [(first[kind], count) for kind, count in counts.items()]


@in_report_style
def draw_recorded(rows: list[dict[str, Any]]) -> Figure:
    """Depth, contact, force and markers of the frames that were read, over time where that of all
    is known and goes on, otherwise over their numbers."""

    def column(name: str) -> np.ndarray:
        return np.array([np.nan if row.get(name) is None else row[name] for row in rows], float)

    known = {name: column(name) for name in COLUMNS if name not in TEXTS}
    sigma = 2 * known["depth_error_mm"]
    known["depth_low_mm"] = known["depth_mm"] - sigma
    known["depth_high_mm"] = known["depth_mm"] + sigma
    over, label_x = known["frame"], "frame"
    if (np.diff(known["time_s"], prepend=-1.0) > 0).all():
        over, label_x = known["time_s"], "time [s]"
    shown = [curve for curve in CURVES if np.isfinite(known[curve[1]]).any()] or [CURVES[0]]
    figure, axes = new_figure(8.0, 1.2 + 1.6 * len(shown), len(shown), 1)
    for ax, (label, name, low, high) in zip(np.atleast_1d(axes), shown, strict=True):
        ax.plot(over, known[name], color=BLUE, marker=".", lw=1.0)
        if low:
            ax.fill_between(over, known[low], known[high], color=BLUE, alpha=0.2, lw=0)
        ax.axhline(0, color=LIGHT, lw=0.8)
        ax.set_ylabel(label)
    np.atleast_1d(axes)[-1].set_xlabel(label_x)
    return figure
