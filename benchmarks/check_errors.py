# SPDX-License-Identifier: Apache-2.0
"""How often the check of captures errs: good frames that it names, spoiled ones that it misses.

Published sets are imported as a user would, and every finding that names frames is counted on them
as they are: false alarms. Every sixth press is then spoiled in one way at a time, and it is counted
whether the finding for that fault names it. The limits of the findings were not chosen on all sets
(see docs/captures.md); each set is a row of its own, so that any of them can be left out.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from taccel_lab.benchmarks.capture_sets import Case, ImportedSets
from taccel_lab.benchmarks.results import ResultFile, note
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.captures import ContactCircle, Press
    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.calibration.check.background import BackgroundCheck
    from taccel_lab.calibration.check.frames import FrameFigures
    from taccel_lab.calibration.error_rates import ErrorRate
    from taccel_lab.geometry import PixelGrid

SETS = (
    Case("GelSight (taxim)", "taxim:gelsight", "", "check", ()),
    Case("GelSight Mini (FOTS)", "fots_calib", "gelsight", "check", ()),
    Case("lab-made (RVSATHU)", "gelsight_rvsathu_sim2real", "", "check", ()),
    Case("GelSight Mini (ruihangao)", "gsmini_ruihangao_calib", "", "check", ()),
    Case("GelSlim 3.0", "gelslim_mcubelab", "", "check", ()),
    Case("DIGIT (FOTS)", "fots_calib", "digit", "check", ()),
)
JUDGED = (
    "no_contact",
    "labels_off",
    "blurred",
    "other_ball",
    "ball_too_small",
    "ball_too_deep",
    "mixed_sensors",
    "channels_swapped",
    "near_duplicates",
)
"""Findings that call frames bad by a judgement; of the pixels at full level, which are counted,
those named of frames that have few of them are false alarms."""
EVERY = 6
BLUR_RADII, SHIFT_RADII, LABEL_FACTOR, SMALL, LARGE, BRIGHT = 0.15, 0.5, 1.5, 0.6, 1.6, 2.0
AGAIN_GAIN, AGAIN_NOISE = 1.01, 1.0
"""Of a press that is shown once more: its light, and the noise of the second picture [levels]."""
THIN = 0.7
"""Thickness that a gel is stated to have, over the median depth of its contacts."""


@dataclass(frozen=True)
class Measured:
    """A set with the figures of its presses."""

    name: str
    folder: CaptureFolder
    frames: list[FrameFigures]
    background: BackgroundCheck
    grid: PixelGrid


@dataclass(frozen=True)
class Fault:
    """A way to spoil a press, and the finding that should name it."""

    name: str
    code: str
    spoil: Callable[[FrameFigures, Measured, Measured], Press | None]
    """A copy of the press, by its figures, its set and another set; None where it cannot be."""


def _background(frame: FrameFigures, own: Measured, other: Measured) -> Press | None:
    rng = np.random.default_rng(0)
    clean = frame.light.apply(own.background.image)
    noisy = clean + rng.normal(0.0, 1.0, clean.shape)
    return _shown(frame, noisy)


def _blurred(frame: FrameFigures, own: Measured, other: Measured) -> Press | None:
    import cv2

    circle = frame.circle
    if circle is None:
        return None
    image = frame.press.image().astype(np.float32)
    return _shown(frame, cv2.GaussianBlur(image, (0, 0), BLUR_RADII * circle.radius_px))


def _other_sensor(frame: FrameFigures, own: Measured, other: Measured) -> Press | None:
    import cv2

    image = other.frames[0].press.image().astype(np.float32)
    size = own.grid.width_px, own.grid.height_px
    return _shown(frame, cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def _swapped(frame: FrameFigures, own: Measured, other: Measured) -> Press | None:
    return _shown(frame, frame.press.image()[..., ::-1])


def _saturated(frame: FrameFigures, own: Measured, other: Measured) -> Press | None:
    return _shown(frame, BRIGHT * frame.press.image().astype(np.float32))


def _again(frame: FrameFigures, own: Measured, other: Measured) -> Press | None:
    place = next(i for i, known in enumerate(own.frames) if known is frame)
    shown = own.frames[(place + 1) % len(own.frames)].press
    rng = np.random.default_rng(place)
    image = AGAIN_GAIN * shown.image().astype(np.float64)
    copy = _shown(frame, image + rng.normal(0.0, AGAIN_NOISE, image.shape))
    return replace(copy, circle=shown.circle)


def _label_shifted(frame: FrameFigures, own: Measured, other: Measured) -> Press | None:
    label = frame.press.circle
    if label is None:
        return None
    inward = 1.0 if label.u_px < own.grid.width_px / 2 else -1.0
    moved = label.u_px + inward * SHIFT_RADII * label.radius_px
    return replace(frame.press, circle=replace(label, u_px=moved))


def _label_wide(frame: FrameFigures, own: Measured, other: Measured) -> Press | None:
    label = frame.press.circle
    if label is None:
        return None
    return replace(frame.press, circle=replace(label, radius_px=LABEL_FACTOR * label.radius_px))


def _zoomed(factor: float) -> Callable[[FrameFigures, Measured, Measured], Press | None]:
    """The press of a ball of ``factor`` times the radius: the change of light, zoomed about the
    middle of the contact, on the gel as it is."""

    def spoil(frame: FrameFigures, own: Measured, other: Measured) -> Press | None:
        import cv2

        circle = frame.circle
        if circle is None or not _inside(circle, factor, own.grid):
            return None
        gel = np.clip(frame.light.apply(own.background.image), 0, 255).astype(np.float32)
        change = frame.press.image().astype(np.float32) - gel
        centre = np.array([circle.u_px, circle.v_px])
        zoom = np.column_stack([factor * np.eye(2), centre * (1.0 - factor)])
        size = own.grid.width_px, own.grid.height_px
        moved = cv2.warpAffine(change, zoom, size, borderMode=cv2.BORDER_REPLICATE)
        label = frame.press.circle
        given = None if label is None else replace(label, radius_px=factor * label.radius_px)
        return replace(_shown(frame, gel + moved), circle=given)

    return spoil


def _inside(circle: ContactCircle, factor: float, grid: PixelGrid) -> bool:
    reach = factor * circle.radius_px
    return bool(
        reach < circle.u_px < grid.width_px - reach and reach < circle.v_px < grid.height_px - reach
    )


def _shown(frame: FrameFigures, image: np.ndarray) -> Press:
    """The press with another image."""
    levels = np.clip(np.round(image), 0, 255).astype(np.uint8)
    digest = f"spoiled {frame.press.sha256}"
    return replace(frame.press, read=lambda: np.ascontiguousarray(levels), sha256=digest)


FAULTS = (
    Fault("the background shown as a press", "no_contact", _background),
    Fault("blurred by 0.15 radii", "blurred", _blurred),
    Fault("label moved by half a radius", "labels_off", _label_shifted),
    Fault("label 1.5 times as wide", "labels_off", _label_wide),
    Fault("a ball of 0.6 times the radius", "other_ball", _zoomed(SMALL)),
    Fault("a ball of 1.6 times the radius", "other_ball", _zoomed(LARGE)),
    Fault("a frame of another sensor", "mixed_sensors", _other_sensor),
    Fault("red and blue swapped", "channels_swapped", _swapped),
    Fault("twice as bright", "saturated", _saturated),
    Fault("the next press once more", "near_duplicates", _again),
)
BALL_FACTORS = (0.5, 0.7, 2.0)
TOO_SMALL = BALL_FACTORS[:2]
"""A ball that is stated too large does not show in colours."""
BALL_CODES = ("ball_too_small", "ball_too_deep", "wrong_ball_radius")


@dataclass(frozen=True)
class CheckErrors(Suite):
    """False alarms and misses of capture check on published sets, good and spoiled, CPU."""

    name: ClassVar[str] = "check_errors"
    what: ClassVar[str] = "findings of capture check on good frames, and on frames spoiled one way"

    def settings(self) -> dict[str, Any]:
        return {"every": EVERY, "blur_radii": BLUR_RADII, "shift_radii": SHIFT_RADII}

    def measure_rows(self, result: ResultFile) -> None:
        if self.device != "cpu":
            raise InputError(f"captures are checked on the CPU, got --device {self.device}")
        with tempfile.TemporaryDirectory() as scratch:
            imported = ImportedSets(Path(scratch))
            sets = [
                _measure(case.name, folder)
                for case in SETS
                if (folder := imported.folder(case)) is not None
            ]
            for number, own in enumerate(sets):
                other = sets[(number + 1) % len(sets)]
                rows = (_good(own), *_spoiled(own, other), *_balls(own), *_thin_gel(own))
                for row in rows:
                    result.add(row)
                    note(f"{row['set']}: {row['case']}: {row['named']} of {row['count']}")


def _measure(name: str, path: Path) -> Measured:
    from taccel_lab.calibration.capture import load_capture_folder
    from taccel_lab.calibration.check.background import check_background
    from taccel_lab.calibration.check.frames import measure_presses
    from taccel_lab.calibration.check.run import press_grid

    folder = load_capture_folder(path)
    background = check_background(folder)
    grid = press_grid(folder, background.image)
    frames = measure_presses(folder.presses, background.image, folder.mask, grid)
    return Measured(name, folder, frames, background, grid)


def _named(own: Measured, frames: Sequence[FrameFigures]) -> dict[str, set[str]]:
    """Names of the presses that each finding is about."""
    from taccel_lab.calibration.capture.sensor_facts import sensor_facts
    from taccel_lab.calibration.check.run import press_findings

    facts = sensor_facts(own.folder.sensor)
    found = press_findings(own.folder, list(frames), own.background, own.grid, facts)
    named: dict[str, set[str]] = {}
    for finding in found:
        named.setdefault(finding.code, set()).update(finding.frames)
    return named


def _good(own: Measured) -> dict[str, Any]:
    from taccel_lab.calibration.check.light import SATURATED_SHARE

    named = _named(own, own.frames)
    by_code = {code: sorted(named.get(code, set())) for code in JUDGED}
    some = set().union(*by_code.values())
    clean = {f.press.name for f in own.frames if f.saturated_share <= SATURATED_SHARE}
    by_code["saturated"] = sorted(named.get("saturated", set()) & clean)
    return {
        "set": own.name,
        "case": "good",
        "count": len(own.frames),
        "labelled": sum(frame.press.circle is not None for frame in own.frames),
        "not_saturated": len(clean),
        "of_known_depth": len(_depths_mm(own)),
        "named": len(some),
        "by_code": by_code,
    }


def _depths_mm(own: Measured) -> list[float]:
    """Depth of each contact by its circle and the ball; empty where the scale, the ball or the
    thickness of the sensor's gel is not known."""
    from taccel_lab.calibration.capture.sensor_facts import sensor_facts

    ball, facts = own.folder.ball_radius_mm, sensor_facts(own.folder.sensor)
    if ball is None or own.folder.mm_per_px is None or facts is None or facts.thickness_mm is None:
        return []
    radii = [f.circle.radius_px * own.grid.mm_per_px_x for f in own.frames if f.circle is not None]
    return [ball - (ball**2 - min(radius, ball) ** 2) ** 0.5 for radius in radii]


def _thin_gel(own: Measured) -> list[dict[str, Any]]:
    """The gel stated thinner than its contacts are deep: how many of those are named."""
    from taccel_lab.calibration.check.balls import check_balls

    depths = _depths_mm(own)
    if not depths:
        return []
    thickness = THIN * float(np.median(depths))
    ball, width = own.folder.ball_radius_mm, own.grid.width_px
    found = check_balls(own.frames, own.grid, width, ball, thickness)
    named = {name for item in found if item.code == "ball_too_deep" for name in item.frames}
    return [
        {
            "set": own.name,
            "case": "gel stated thinner than the contacts are deep",
            "code": "ball_too_deep",
            "count": sum(depth > thickness for depth in depths),
            "named": len(named),
            "thickness_mm": thickness,
        }
    ]


def _spoiled(own: Measured, other: Measured) -> list[dict[str, Any]]:
    from taccel_lab.calibration.check.frames import measure_presses

    rows = []
    good = _named(own, own.frames)
    for fault in FAULTS:
        # What the finding says of the good frames already is no answer to the fault.
        fit = [n for n, f in enumerate(own.frames) if f.press.name not in good.get(fault.code, ())]
        copies = {n: fault.spoil(own.frames[n], own, other) for n in fit[::EVERY]}
        presses = {n: press for n, press in copies.items() if press is not None}
        if not presses:
            continue
        changed = measure_presses(
            list(presses.values()), own.background.image, own.folder.mask, own.grid
        )
        frames = list(own.frames)
        for number, frame in zip(presses, changed, strict=True):
            frames[number] = frame
        named = _named(own, frames)
        bad = {press.name for press in presses.values()}
        rows.append(
            {
                "set": own.name,
                "case": fault.name,
                "code": fault.code,
                "count": len(bad),
                "named": len(bad & named.get(fault.code, set())),
                "named_by_any": len(bad & set().union(*named.values())),
                "good_named": len(named.get(fault.code, set()) - bad),
            }
        )
    return rows


def _balls(own: Measured) -> list[dict[str, Any]]:
    """The radius of all presses stated wrongly: whether the set is told."""
    from taccel_lab.calibration.check.balls import check_slopes

    radius = own.folder.ball_radius_mm
    if radius is None or own.folder.mm_per_px is None:
        return []
    rows = []
    for factor in (1.0, *BALL_FACTORS):
        folder = replace(own.folder, ball_radius_mm=factor * radius)
        named = set(_named(replace(own, folder=folder), own.frames))
        named |= {
            finding.code
            for finding in check_slopes(folder, own.background.image)
            if finding.code in BALL_CODES
        }
        rows.append(
            {
                "set": own.name,
                "case": f"ball stated {factor:g} times as large",
                "code": "wrong_ball_radius",
                "count": 1,
                "named": int(bool(named & set(BALL_CODES))),
                "by": sorted(named & set(BALL_CODES)),
            }
        )
    return rows


SPOILED_HOW = {
    "no_contact": "that show the background",
    "labels_off": "whose label is moved by half a radius or 1.5 times as wide",
    "blurred": "that are blurred by 0.15 contact radii",
    "other_ball": "of a ball of 0.6 or 1.6 times the radius",
    "mixed_sensors": "of another sensor",
    "channels_swapped": "whose red and blue are swapped",
    "ball_too_small": "sets whose ball is stated half as large",
    "ball_too_deep": "on a gel that is stated 0.7 times as thick as the median contact is deep",
    "near_duplicates": "that show another press once more, with noise of its own",
    "saturated": "that are made twice as bright",
    "wrong_ball_radius": "sets whose ball is stated 0.5 or 0.7 times as large",
}
_GOOD = {"labels_off": "labelled", "saturated": "not_saturated", "ball_too_deep": "of_known_depth"}
"""Which presses of a set a finding could name by mistake, where these are not all."""


def error_rates(rows: Sequence[dict[str, Any]]) -> dict[str, ErrorRate]:
    """Of each finding over all sets, for ``taccel_lab.calibration.error_rates``."""
    from taccel_lab.calibration.error_rates import ErrorRate

    def stated(factor: float) -> list[dict[str, Any]]:
        return [row for row in rows if row["case"] == f"ball stated {factor:g} times as large"]

    right = stated(1.0)
    known = {row["set"] for row in right}
    found = {}
    for code, how in SPOILED_HOW.items():
        good = [row for row in rows if row["case"] == "good"]
        tried = [row for row in rows if row.get("code") == code]
        if code == "wrong_ball_radius":
            tried = [row for factor in TOO_SMALL for row in stated(factor)]
            named = [sum(code in row["by"] for row in some) for some in (right, tried)]
            found[code] = ErrorRate(named[0], len(right), named[1], len(tried), how, "sets")
            continue
        if code == "ball_too_small":
            good, tried = [row for row in good if row["set"] in known], stated(TOO_SMALL[0])
            named, spoiled = sum(code in row["by"] for row in tried), len(tried)
        else:
            named = sum(row["named"] for row in tried)
            spoiled = sum(row["count"] for row in tried)
        found[code] = ErrorRate(
            sum(len(row["by_code"][code]) for row in good),
            sum(row[_GOOD.get(code, "count")] for row in good),
            named,
            spoiled,
            how,
        )
    return found
