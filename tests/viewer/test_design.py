# SPDX-License-Identifier: Apache-2.0
"""Answers of the design page: pieces in order, scaled presses, refusals, exports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.cli.app import main
from taccel_lab.errors import InputError
from taccel_lab.sensors.registry import sensor_families, sensor_family
from taccel_lab.viewer.design_answer import Answer, Choice, DesignAnswers
from taccel_lab.viewer.design_controls import slider_places
from taccel_lab.viewer.design_export import TOML, command_line, export, read_design
from taccel_lab.viewer.design_press import BallPress, SupersededError, formula_force_n, press_ball

PRESS = BallPress(3.0, 0.4)


class Stopped(Exception):
    pass


def pieces_until(answers: DesignAnswers, choice: Choice, last: str) -> tuple[list[str], Answer]:
    pieces: list[str] = []
    found: list[Answer] = []

    def told(piece: str, answer: Answer) -> None:
        pieces.append(piece)
        found.append(answer)
        if piece == last:
            raise Stopped

    with pytest.raises(Stopped):
        answers.answer(choice, told)
    return pieces, found[-1]


def test_pieces_come_in_order_and_a_softer_gel_scales_the_press_that_is_known() -> None:
    answers = DesignAnswers(sensor_family("flat_pad"))
    default = sensor_family("flat_pad").parameters()
    stiff = default.values()["young_modulus_mpa"]
    pieces, first = pieces_until(answers, Choice({}, PRESS), "quality")
    assert pieces == ["formula", "solid", "quick", "quality"]
    _, soft = pieces_until(answers, Choice({"young_modulus_mpa": stiff / 2}, PRESS), "quick")
    assert first.quick is not None and soft.quick is not None
    assert soft.quick.force_n == pytest.approx(first.quick.force_n / 2, rel=1e-12)
    assert soft.quick.positions_m is first.quick.positions_m
    # That scaling is what a simulation gives.
    simulated = press_ball(soft.parameters, soft.press, quick=True, superseded=lambda: False)
    assert soft.quick.force_n == pytest.approx(simulated.force_n, rel=2e-3)
    # The formula, for a flat pad with friction left out, is near.
    assert first.formula_n == pytest.approx(first.quick.force_n, rel=0.2)
    assert first.quality is not None and first.quality.min_dihedral_deg > 5


def test_a_newer_wish_ends_the_work_between_steps() -> None:
    asked = []

    def superseded() -> bool:
        asked.append(True)
        return len(asked) > 1

    parameters = sensor_family("flat_pad").parameters()
    with pytest.raises(SupersededError):
        press_ball(parameters, PRESS, quick=True, superseded=superseded)
    assert len(asked) == 2


def test_presses_stay_within_the_gel_and_domes_have_no_formula() -> None:
    assert BallPress(3.0, 2.0).limited(1.0).depth_mm == pytest.approx(0.4)
    assert BallPress(3.0, 0.2).limited(1.0).depth_mm == 0.2
    assert np.isnan(formula_force_n(sensor_family("rtac").parameters(), PRESS))


def test_refusals_are_those_of_the_family() -> None:
    answers = DesignAnswers(sensor_family("digit"))
    with pytest.raises(InputError, match="window_thickness_mm"):
        answers.answer(Choice({"window_thickness_mm": 1e3}), lambda *_: None)


@pytest.mark.parametrize("name", sorted(sensor_families()))
def test_sliders_reach_the_bounds_of_every_parameter(name: str) -> None:
    for parameter in sensor_family(name).parameters_type.parameters().values():
        if parameter.choices:
            continue
        low, high, step = slider_places(parameter)
        assert parameter.minimum is not None and parameter.maximum is not None
        assert low <= parameter.minimum and high == parameter.maximum
        assert low <= parameter.default <= high and 0 < step <= (high - low) / 10
        if parameter.zero_means:
            assert low <= 0


def test_parameters_are_written_below_out_and_read_again(tmp_path: Path) -> None:
    family, changed = sensor_family("digit"), {"thickness_mm": 3.2, "thin_crown": "kept"}
    files = export(TOML, family, changed, tmp_path / "out")
    assert all(path.is_relative_to(tmp_path / "out") for path in files.values())
    assert read_design(files["parameters"]) == ("digit", changed)
    export(TOML, family, {}, tmp_path / "out")
    assert read_design(files["parameters"]) == ("digit", {})
    assert command_line(family, changed, Path("out dir")) == (
        "taccel-lab design digit --out 'out dir/everything' --set thickness_mm=3.2 thin_crown=kept"
    )


def test_files_of_others_stay(tmp_path: Path) -> None:
    (tmp_path / "parameters").mkdir()
    (tmp_path / "parameters" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.txt"):
        export(TOML, sensor_family("digit"), {}, tmp_path)


@pytest.mark.parametrize("text", ["x = 1", "sensor = 3", 'sensor = "digit"\nparameters = 1'])
def test_other_files_are_no_designs(tmp_path: Path, text: str) -> None:
    path = tmp_path / "design.toml"
    path.write_text(text)
    with pytest.raises(InputError, match="is no design"):
        read_design(path)


def test_a_page_for_parameters_out_of_bounds_does_not_open(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["design", "digit", "--out", str(tmp_path / "out"), "--page", "--no-browser"]
    assert main([*words, "--port", "0", "--set", "thickness_mm=99"]) == 2
    assert "above its bound" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "9dtact"])
def test_the_quick_press_is_as_near_as_the_page_says(name: str) -> None:
    from taccel_lab.viewer.design_words import QUICK_PERCENT

    parameters = sensor_family(name).parameters()
    press = PRESS.limited(parameters.pad().thickness_mm)
    quick, exact = (
        press_ball(parameters, press, quick=one, superseded=lambda: False) for one in (True, False)
    )
    assert quick.force_n == pytest.approx(exact.force_n, rel=QUICK_PERCENT / 100)
