# SPDX-License-Identifier: Apache-2.0
"""GelSlim 3.0 (mcubelab/gelslim; CC BY-NC 4.0): ``ref.jpg`` and ``sample_<n>.jpg`` of each set.

Facts used: ball of 7.6 mm and 0.10577 mm/px (its ``calibration.py``); both may differ between sets.
"""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import first_existing, images_in
from taccel_lab.calibration.capture.importers.layout import Layout

SOURCE = "GelSlim 3.0 (mcubelab/gelslim)"
LICENSE = "CC BY-NC 4.0"
BALL_RADIUS_MM = 3.8
MM_PER_PX = 0.10577


def _sets(path: Path) -> list[Path]:
    places = [path, *sorted(p for p in path.rglob("*") if p.is_dir())] if path.is_dir() else []
    return [p for p in places if _reference(p) is not None and any(p.glob("sample_*.*"))]


def _reference(path: Path) -> Path | None:
    return first_existing(path / "ref.jpg", path / "ref.png")


def _recognises(path: Path) -> bool:
    return bool(_sets(path))


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    sets = _sets(path)
    drafts = []
    for place in sets:
        draft = Draft(
            place.name if len(sets) > 1 else "", "flat_pad", f"{SOURCE}, {place.name}", LICENSE
        )
        reference = _reference(place)
        assert reference is not None
        draft.set_background(reference)
        draft.set_ball(BALL_RADIUS_MM)
        draft.set_scale(MM_PER_PX)
        draft.notes.append("ball and scale are those of its calibration.py, whatever the set")
        for image in images_in(place):
            if image.stem.startswith("sample_"):
                draft.add_press(image)
        drafts.append(draft)
    return drafts


LAYOUT = Layout("gelslim", "GelSlim: ref.jpg and sample_<n>.jpg", _recognises, _read)
