# SPDX-License-Identifier: Apache-2.0
"""How well real captures are calibrated, and in what time: published sets through the commands.

Every set is imported as a user would, the command of each block runs on it, and the figures of
its report are compared with goals. Figures of colours and normals are of presses that were chosen
before any image was read and seen when the model was frozen, one protocol for all sets; those of
lenses are of frames that the fit did not see. Sets that are not on this machine are left out and
named.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from taccel_lab.benchmarks.results import ResultFile, Suite, note
from taccel_lab.errors import InputError
from taccel_lab.exporters.published_meshes import data_folder


@dataclass(frozen=True)
class CaptureFigure:
    """A figure of a report with its goal."""

    name: str
    path: str
    """Dotted path in the report's JSON."""
    goal: float
    at_least: bool = False
    """Whether more is better."""


@dataclass(frozen=True)
class CaptureCase:
    """One command on one set."""

    name: str
    source: str
    """Folder below the data folder, or ``taxim:`` and the name of a pack of that wheel."""
    part: str
    """Folder of the import; empty where there is one."""
    command: str
    figures: tuple[CaptureFigure, ...]


def _colors(psnr: float, disc: float) -> tuple[CaptureFigure, ...]:
    return (
        CaptureFigure("PSNR, placed by label [dB]", "color.heldout.crop_psnr_db", psnr, True),
        CaptureFigure("L1 in the disc, placed by label [levels]", "color.heldout.disc_l1", disc),
        CaptureFigure("held-out presses that failed", "color.heldout_failed", 0),
    )


def _normals(goal: float) -> tuple[CaptureFigure, ...]:
    return (
        CaptureFigure("normals, placed by label [deg]", "heldout.in_used_circles.mean_deg", goal),
    )


def _touches(smallest_mm: float) -> tuple[CaptureFigure, ...]:
    return (
        CaptureFigure("95 % of touches seen, ball R 4 [mm]", "smallest_mm.value", smallest_mm),
        CaptureFigure("untouched, interval without 0 [share]", "untouched.share.value", 0),
        CaptureFigure("untouched, 95 % of upper ends [N]", "untouched.most_n", 0.2),
    )


def _contacts() -> tuple[CaptureFigure, ...]:
    return (
        CaptureFigure("centre, median [px]", "agreement.center_median_px", 2.0),
        CaptureFigure("radius, median [px]", "agreement.radius_median_px", 2.0),
    )


TAXIM, FOTS, RVSATHU = "taxim:gelsight", "fots_calib", "gelsight_rvsathu_sim2real"
STATED = {
    # Its authors' board, which no file says.
    "9dtact_official": ("--board", "dots:9x7:2.5"),
    **{
        source: ("--layout", layout)
        for source, layout in (
            (FOTS, "fots"),
            (RVSATHU, "rvsathu"),
            ("gelsight_osaka_photon26", "osaka"),
            ("gsmini_feats_calib", "feats"),
        )
    },
}
"""Options of the import."""
CASES = (
    CaptureCase("GelSight (taxim)", TAXIM, "", "contacts", _contacts()),
    CaptureCase("GelSight Mini (FOTS)", FOTS, "gelsight", "contacts", _contacts()),
    CaptureCase("lab-made (RVSATHU)", RVSATHU, "", "contacts", _contacts()),
    CaptureCase("GelSight (taxim)", TAXIM, "", "color", _colors(34.0, 2.5)),
    CaptureCase("GelSight Mini (FOTS)", FOTS, "gelsight", "color", _colors(32.7, 4.9)),
    CaptureCase("lab-made (RVSATHU)", RVSATHU, "", "color", _colors(29.5, 9.0)),
    CaptureCase("GelSight (taxim)", TAXIM, "", "normals", _normals(3.3)),
    CaptureCase("GelSight Mini (FOTS)", FOTS, "gelsight", "normals", _normals(6.0)),
    CaptureCase("lab-made (RVSATHU)", RVSATHU, "", "normals", _normals(3.2)),
    CaptureCase("lab-made (RVSATHU)", RVSATHU, "", "touch", _touches(0.1)),
    CaptureCase("GelSight Mini (FOTS)", FOTS, "gelsight", "touch", _touches(0.05)),
    CaptureCase("GelSight (taxim)", TAXIM, "", "touch", _touches(0.05)),
    CaptureCase(
        "fisheye GelSight (Photon26)", "gelsight_osaka_photon26", "", "camera",
        (CaptureFigure("held-out reprojection [px]", "intrinsics.heldout_rms_px", 0.70),),
    ),
    CaptureCase(
        "9DTact, unit 1", "9dtact_official", "sensor_1", "camera",
        (CaptureFigure("scale against 0.0510 mm/px", "on_gel.mm_per_px_x.value|0.0510", 0.01),),
    ),
    CaptureCase(
        "9DTact, unit 2", "9dtact_official", "sensor_2", "camera",
        (CaptureFigure("scale against 0.0500 mm/px", "on_gel.mm_per_px_x.value|0.0500", 0.01),),
    ),
    CaptureCase(
        "GelSight Mini video (gsrobotics)", "gsmini_markers_video", "", "markers",
        (
            CaptureFigure("rest jitter [px]", "residuals.rest_jitter_px", 0.02),
            CaptureFigure("return error [px]", "residuals.return_error_px", 0.6),
        ),
    ),
    CaptureCase(
        "GelSight Mini (FEATS)", "gsmini_feats_calib", "", "material",
        (
            CaptureFigure(
                "worst point, left out", "residuals.indentation_held_out_worst_relative", 0.03
            ),
        ),
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Captures(Suite):
    """Accuracy and time of every calibration on published captures of real sensors, CPU."""

    name: ClassVar[str] = "captures"
    what: ClassVar[str] = (
        "real captures through the commands of calibration; goals beside the figures"
    )
    shown: ClassVar[tuple[str, ...]] = ("command", "figure", "value", "goal", "met", "seconds")
    only: tuple[str, ...] = ()
    """Commands to run: contacts, color, normals, touch, camera, markers, material. Default:
    all."""

    def measure_rows(self, result: ResultFile) -> None:
        if self.device != "cpu":
            raise InputError(f"captures are calibrated on the CPU, got --device {self.device}")
        with tempfile.TemporaryDirectory() as scratch:
            imported = cache(partial(_imported, Path(scratch)))
            for case in CASES:
                if self.only and case.command not in self.only:
                    continue
                folder = None if result.deadline.passed else imported(case.source)
                if folder is None:
                    spent = "the budget is spent" if result.deadline.passed else "not here"
                    note(f"{case.name}, {case.command}: {spent}")
                    continue
                for row in _run_case(case, folder / case.part, Path(scratch)):
                    result.add(row, case.name)


def _imported(scratch: Path, source: str) -> Path | None:
    """Folder of an imported set, or None where the set is not on this machine."""
    from taccel_lab.calibration.capture import find_taxim_pack

    if source.startswith("taxim:"):
        try:
            path = find_taxim_pack()
        except InputError:
            return None
    else:
        path = data_folder() / source
    if not path.exists():
        return None
    out = scratch / source.replace(":", "_")
    _main("capture", "import", str(path), str(out), *STATED.get(source, ()))
    return out


def _run_case(case: CaptureCase, folder: Path, scratch: Path) -> Iterator[dict[str, Any]]:
    started = time.perf_counter()
    if case.command == "contacts":
        report = _contact_report(folder)
    elif case.command == "touch":
        report = _touch_report(case, folder, scratch)
    else:
        report = _report(case, folder, scratch)
    seconds = time.perf_counter() - started
    for figure in case.figures:
        value = _pick(report, figure.path)
        met = value >= figure.goal if figure.at_least else value <= figure.goal
        yield {
            "set": case.name,
            "command": case.command,
            "figure": figure.name,
            "value": value,
            "interval": _interval(report, figure.path),
            "goal": figure.goal,
            "at_least": figure.at_least,
            "met": bool(met),
            "verdict": report.get("verdict"),
            "fit_seconds": report.get("fit_seconds", report.get("color", {}).get("fit_seconds")),
            "seconds": seconds,
        }


def _fitted(case: CaptureCase, scratch: Path) -> Path:
    """Folder of the profile that a case's command writes."""
    return scratch / f"{case.source}_{case.part}_{case.command}".replace(":", "_")


def _report(case: CaptureCase, folder: Path, scratch: Path) -> dict[str, Any]:
    out = _fitted(case, scratch)
    path, errors = out.with_name(out.name + "_report") / "report.json", ""
    if not path.is_file():
        errors = _main("calibrate", case.command, str(folder), "--out", str(out))
    if not path.is_file():
        raise InputError(f"calibrate {case.command} of {case.name} wrote no report: {errors}")
    return json.loads(path.read_text(encoding="utf-8"))


def _touch_report(case: CaptureCase, folder: Path, scratch: Path) -> dict[str, Any]:
    """Touches and untouched frames as the profile of both calibrations reads them."""
    from taccel_lab.calibration.capture import load_captures
    from taccel_lab.profile import load_profile
    from tools.bench.smallest_touch import touch_figures

    by = {}
    for command in ("color", "normals"):
        fitted = replace(case, command=command)
        _report(fitted, folder, scratch)
        by[command] = load_profile(_fitted(fitted, scratch))
    profile = by["normals"].with_block(by["color"].color, by["color"].color_weights)
    captures = load_captures(folder)
    return touch_figures(profile, captures.background, [p.image() for p in captures.presses])


def _contact_report(folder: Path) -> dict[str, Any]:
    """Contacts found without any label, against the labels."""
    from taccel_lab.calibration.capture import load_captures
    from taccel_lab.calibration.circles.labels import circle_array
    from taccel_lab.calibration.circles.usable import usable_presses

    captures, contacts, _ = usable_presses(load_captures(folder))
    pairs = [
        (contact.circle, press.circle)
        for press, contact in zip(captures.presses, contacts, strict=True)
        # What a person has corrected was not detected.
        if press.circle is not None and not press.checked
    ]
    if not pairs:
        raise InputError(f"{folder} holds no labels to compare with")
    found, given = (circle_array(circles) for circles in zip(*pairs, strict=True))
    off = found - given
    center, radius = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])
    medians = {"center_median_px": np.median(center), "radius_median_px": np.median(radius)}
    return {"agreement": {name: float(value) for name, value in medians.items()}}


def _pick(report: dict[str, Any], path: str) -> float:
    """The value at a dotted path; after a bar, its relative distance to that number."""
    dotted, _, reference = path.partition("|")
    value = _at(report, dotted)
    return abs(float(value) / float(reference) - 1) if reference else float(value)


def _at(report: dict[str, Any], dotted: str) -> Any:
    value: Any = report
    for key in dotted.split("."):
        value = value[key]
    return value


def _interval(report: dict[str, Any], path: str) -> list[float] | None:
    """The 95 % interval that stands beside a value; None where there is none."""
    above, _, name = path.rpartition(".")
    return _at(report, above).get("interval") if name == "value" else None


def _main(*arguments: str) -> str:
    """Run a command in its own process, as a user does; return what it writes to stderr."""
    # Exit code 1: done, and parts of it weak or refused; the report says which.
    done = subprocess.run(
        [sys.executable, "-m", "taccel_lab.cli.app", *arguments], capture_output=True, text=True
    )
    if done.returncode not in (0, 1):
        raise InputError(f"taccel-lab {' '.join(arguments)}: {done.stderr.strip()}")
    return done.stderr.strip()
