# SPDX-License-Identifier: Apache-2.0
"""Real captures: every set imports, and the check says what is known to be wrong with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureFolder, import_captures, load_capture_folder
from taccel_lab.calibration.capture.importers import ImportOptions, detect_layout
from taccel_lab.calibration.check import CaptureCheck, check_captures
from taccel_lab.errors import InputError
from tests.calibration.capture.made_up_layouts import SCRIPTED
from tests.calibration.judged_once import detect_once
from tests.support.real_data import real_data, taxim_presses

LAYOUTS = {
    "9dtact_official": "9dtact",
    "backgrounds_misc": "plain",
    "digit_aurova": "plain",
    "fots_calib": "fots",
    "gelsight_osaka_photon26": "osaka",
    "gelsight_rvsathu_sim2real": "rvsathu",
    "gelslim_mcubelab": "gelslim",
    "gsmini_cube_edges": "cube-edges",
    "gsmini_feats_calib": "feats",
    "gsmini_gs_sdk": "gs-sdk",
    "gsmini_markers_video": "markers",
    "gsmini_ruihangao_calib": "ruihangao",
}


OPTIONS = {"9dtact_official": ImportOptions(board="dots:9x7:2.5")}
"""What no file of a set states and an importer asks for."""


def some_presses(folder: CaptureFolder, count: int) -> CaptureFolder:
    """Evenly picked presses: enough to judge, in a fraction of the time."""
    pick = np.linspace(0, len(folder.presses) - 1, count).astype(int)
    return replace(folder, presses=tuple(folder.presses[i] for i in np.unique(pick)))


def codes(check: CaptureCheck) -> dict[str, str]:
    return {finding.code: finding.message for finding in check.findings}


@pytest.fixture(scope="module", autouse=True)
def _equal_pictures_are_looked_at_once() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        detect_once(patch)
        yield


Imported = Callable[[str], list[CaptureFolder]]


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Imported:
    """The capture folders that are made of a set, once."""

    @cache
    def made(name: str) -> list[CaptureFolder]:
        out = tmp_path_factory.mktemp("set") / "out"
        layout = LAYOUTS[name] if LAYOUTS[name] in SCRIPTED else "auto"
        folders = import_captures(real_data(name), out, layout, OPTIONS.get(name))
        return [load_capture_folder(folder) for folder in folders]

    return made


@pytest.mark.thorough(cases=("gsmini_markers_video",))
@pytest.mark.parametrize("name", sorted(LAYOUTS))
def test_every_set_imports(name: str, imported: Imported) -> None:
    if LAYOUTS[name] not in SCRIPTED:
        assert detect_layout(real_data(name)).name == LAYOUTS[name]
    assert all(sum(folder.contents().values()) > 0 for folder in imported(name))


@pytest.mark.thorough
def test_background_that_is_a_crop_of_the_presses(imported: Imported) -> None:
    folder = some_presses(imported("gsmini_ruihangao_calib")[0], 7)
    check = check_captures(folder, fit_ball=False)
    (finding,) = [found for found in check.findings if found.code == "background_differs"]
    assert "--background median" in finding.message and not check.usable


@pytest.mark.thorough
def test_automatic_white_balance(imported: Imported) -> None:
    folder = some_presses(imported("fots_calib")[0], 6)
    found = codes(check_captures(folder, fit_ball=False))
    assert {"light_drifts", "saturated"} <= set(found)
    assert {"coverage", "one_spot"} & set(found)
    assert not {"mixed_sensors", "channels_swapped", "lamps_reversed", "labels_off"} & set(found)


@pytest.mark.thorough
def test_good_captures_are_usable(imported: Imported) -> None:
    folder = some_presses(imported("gelsight_rvsathu_sim2real")[0], 5)
    check = check_captures(folder)
    assert check.usable
    assert not {"light_drifts", "labels_off", "mixed_sensors", "blurred"} & set(codes(check))
    assert "wrong_ball_radius" not in codes(check)


@pytest.mark.thorough
def test_a_label_that_was_moved_is_rejected_and_no_other(imported: Imported) -> None:
    folder = some_presses(imported("gelsight_rvsathu_sim2real")[0], 6)
    assert not check_captures(folder, fit_ball=False).rejected_labels
    first, *others = folder.presses
    assert first.circle is not None
    away = 1.5 * first.circle.radius_px
    toward = away if first.circle.u_px < 160 else -away
    wrong = replace(first, circle=replace(first.circle, u_px=first.circle.u_px + toward))
    spoilt = replace(folder, presses=(wrong, *others))
    assert check_captures(spoilt, fit_ball=False).rejected_labels == {first.name}


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["gelsight_rvsathu_sim2real", "gelslim_mcubelab"])
def test_scales_of_sensors_outside_the_catalogue(name: str, imported: Imported) -> None:
    """As stated nothing is said; a quarter is unusual, and eightfold is more than any pad."""
    folder = some_presses(imported(name)[0], 5)
    assert folder.sensor == "flat_pad" and folder.mm_per_px is not None
    x, y = folder.mm_per_px
    for factor, told in ((1.0, None), (0.25, "scale_unusual"), (8.0, "scale_past_pad")):
        scaled = replace(folder, mm_per_px=(factor * x, factor * y))
        found = set(codes(check_captures(scaled, fit_ball=False)))
        assert found & {"scale_unusual", "scale_past_pad"} == ({told} if told else set())


@pytest.mark.thorough
def test_frames_of_another_unit_and_swapped_channels(imported: Imported) -> None:
    folder = some_presses(imported("gsmini_ruihangao_calib")[0], 7)
    foreign = replace(imported("gsmini_gs_sdk")[0].presses[0], name="foreign")
    read = folder.presses[3].read
    bgr = replace(folder.presses[3], read=partial(lambda get: get()[..., ::-1], read))
    for code, odd, presses in (
        ("mixed_sensors", foreign, (*folder.presses, foreign)),
        ("channels_swapped", bgr, (*folder.presses[:3], bgr, *folder.presses[4:])),
    ):
        check = check_captures(replace(folder, presses=presses), fit_ball=False)
        finding = next(found for found in check.findings if found.code == code)
        assert finding.frames == (odd.name,)


@pytest.mark.thorough
def test_mini_presses_of_taxim_are_refused_with_the_reasons() -> None:
    folder = some_presses(load_capture_folder(taxim_presses("gelsight_mini")), 6)
    assert folder.sensor == "gelsight_mini" and folder.ball_radius_mm is None
    check = check_captures(folder)
    found = codes(check)
    assert not check.usable
    assert {"one_spot", "labels_off", "ball_radius_unstated"} <= set(found)
    with pytest.raises(InputError, match="radius of the ball is missing"):
        folder.ball_presses()


@pytest.mark.thorough
def test_boards_edges_and_dots(imported: Imported) -> None:
    unit = imported("9dtact_official")[0]
    check = check_captures(unit)
    assert check.usable and "board_not_found" not in codes(check)
    assert {b.command: str(b.readiness) for b in check.blocks}["depth"] in ("ready", "weak")
    assert {b.command: str(b.readiness) for b in check.blocks}["color"] == "absent"
    dots = imported("fots_calib")[2]
    (message,) = [f.message for f in check_captures(dots).findings if f.code == "no_rest_frame"]
    assert "no grid of dots" not in message
