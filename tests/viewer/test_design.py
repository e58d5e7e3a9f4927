# SPDX-License-Identifier: Apache-2.0
"""Answers of the design page: pieces in order, scaled presses, refusals, exports."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
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


@contextmanager
def answers_of(name: str) -> Iterator[DesignAnswers]:
    answers = DesignAnswers(sensor_family(name))
    try:
        yield answers
    finally:
        answers.close()


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
    default = sensor_family("flat_pad").parameters()
    stiff = default.values()["young_modulus_mpa"]
    with answers_of("flat_pad") as answers:
        pieces, first = pieces_until(answers, Choice({}, PRESS), "quality")
        softer = Choice({"young_modulus_mpa": stiff / 2}, PRESS)
        _, soft = pieces_until(answers, softer, "quick")
    assert [one for one in pieces if one != "step"] == ["formula", "solid", "quick", "quality"]
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


def test_a_design_without_light_or_a_drawing_has_all_other_pieces(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from taccel_lab.viewer import design_answer
    from taccel_lab.viewer.design_words import force_table, stage_words

    def no_drawing(name: str, pad: object) -> np.ndarray:
        raise InputError("the CAD kernel cannot build this pad")

    monkeypatch.setattr(design_answer, "_drawing", no_drawing)
    dark = Choice({"led_depth_mm": 0.1}, BallPress(3.0, 0.2))
    told: list[str] = []
    with answers_of("9dtact") as answers:
        found = answers.answer(dark, lambda piece, _: told.append(piece))
        assert found.quick is not None and found.quality is not None and found.exact is not None
        assert found.exact.force_n == pytest.approx(found.quick.force_n, rel=0.14)
        assert set(found.failed) == {"rest", "pressed", "drawing"}
        assert "no light reaches the gel" in found.failed["rest"]
        assert found.missing == [] and "step" in told
        words = stage_words(found)
        assert words.startswith("**Done**") and "**No drawing:** the CAD kernel cannot" in words
        assert "| default | " in force_table(found)
        # All of it is known now, without a press, and a softer gel's force is scaled.
        soft = {**dark.overrides, "young_modulus_mpa": 0.5 * _modulus(found)}
        again = answers.answer(Choice(soft, dark.press), lambda *_: None)
        assert again.exact is not None and again.seconds["exact"] < 5
        assert again.exact.force_n == pytest.approx(found.exact.force_n / 2, rel=1e-12)


def _modulus(answer: Answer) -> float:
    return float(answer.parameters.values()["young_modulus_mpa"])


def test_what_is_worked_on_is_said_with_the_steps_of_the_press() -> None:
    from taccel_lab.viewer.design_words import force_table, stage_words

    answer = Answer(sensor_family("flat_pad").parameters(), PRESS, formula_n=1.0)
    answer.seconds = {"formula": 0.04, "solid": 0.2}
    answer.exact_steps = (1, 2)
    assert answer.missing == ["quick", "quality", "rest", "pressed", "drawing", "exact"]
    assert stage_words(answer) == (
        "*Next: coarse press and press at default accuracy (step 2 of 2) … (0.2 s)*"
    )
    assert force_table(answer).splitlines()[-2:] == [
        "| coarse | … | |  |",
        "| default | … | | step 2 of 2 |",
    ]
    answer.seconds |= {"quick": 0.5, "quality": 0.6, "rest": 0.8, "pressed": 1.0, "drawing": 1.2}
    answer.failed = {"quick": "it did not converge"}
    assert stage_words(answer).splitlines() == [
        "*Next: press at default accuracy (step 2 of 2) … (1.2 s)*",
        "",
        "**No coarse press:** it did not converge",
    ]
    assert "| coarse | none | |  |" in force_table(answer)


def test_presses_stay_within_the_gel_and_domes_have_no_formula() -> None:
    assert BallPress(3.0, 2.0).limited(1.0).depth_mm == pytest.approx(0.4)
    assert BallPress(3.0, 0.2).limited(1.0).depth_mm == 0.2
    assert np.isnan(formula_force_n(sensor_family("rtac").parameters(), PRESS))


def test_refusals_are_those_of_the_family() -> None:
    with answers_of("digit") as answers, pytest.raises(InputError, match="window_thickness_mm"):
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
