# SPDX-License-Identifier: Apache-2.0
"""Taxim: ``dataPack.npz`` with a ``params.json`` beside it (Si and Yuan, RA-L 2022; MIT)."""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.importers.draft import CaptureLayout, Draft, ImportOptions
from taccel_lab.calibration.capture.importers.origin import UNKNOWN
from taccel_lab.calibration.capture.taxim_pack import (
    PACK_NAME,
    PARAMS_NAME,
    TAXIM_BALL_WHY,
    load_taxim_folder,
)


def _pack(path: Path) -> Path:
    return path / PACK_NAME if path.is_dir() else path


def _recognises(path: Path) -> bool:
    return _pack(path).is_file() and _pack(path).suffix == ".npz"


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    if not _recognises(path):
        return []
    pack = _pack(path)
    stated = None
    if options.mm_per_px_x is not None:
        stated = (options.mm_per_px_x, options.mm_per_px_y or options.mm_per_px_x)
    folder = load_taxim_folder(pack, stated)
    draft = Draft("", folder.sensor, path, assumed=dict(folder.assumed))
    draft.used |= {pack} if stated else {pack, pack.parent / PARAMS_NAME}
    draft.source = folder.provenance.get("source", UNKNOWN)
    draft.license = folder.provenance.get("license", UNKNOWN)
    draft.set_background(folder.require_background().image())
    if folder.mm_per_px is not None:
        draft.set_scale(*folder.mm_per_px)
    if folder.ball_radius_mm is not None:
        draft.set_ball(folder.ball_radius_mm, TAXIM_BALL_WHY)
    elif options.radius_mm is None:
        draft.notes.append("the radius of the ball is stated nowhere; give --radius-mm")
    for press in folder.presses:
        circle = press.circle
        contact = None
        if circle is not None:
            contact = {"u_px": circle.u_px, "v_px": circle.v_px, "radius_px": circle.radius_px}
        draft.add_press(press.image(), press.name, contact=contact)
    return [draft]


LAYOUT = CaptureLayout("taxim", "Taxim: dataPack.npz and params.json", _recognises, _read)
