# SPDX-License-Identifier: Apache-2.0
"""The viewer's design page: answers, presses beside it, sliders, exports."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError, SimulationError
from taccel_lab.files.file_cache import CACHE_VARIABLE
from taccel_lab.geometry import QuadraticMesh
from taccel_lab.sensors.registry import sensor_families, sensor_family
from taccel_lab.viewer import design_answer
from taccel_lab.viewer.background_press import BackgroundPress, NewestFirst
from taccel_lab.viewer.ball_press import (
    SOURCES,
    BallPress,
    PressAnswer,
    SupersededError,
    formula_force_n,
    kept_press,
)
from taccel_lab.viewer.design_answer import (
    QUICK_PERCENT,
    Choice,
    DesignAnswer,
    DesignAnswers,
    _press_key,
    force_table,
    heading,
    stage_words,
    stiffness_words,
)
from taccel_lab.viewer.design_controls import History, slider_places
from taccel_lab.viewer.design_export import TOML, command_line, export, packed, read_design
from taccel_lab.viewer.design_press import press_ball

PRESS, SHORT = BallPress(3.0, 0.4), BallPress(3.0, 0.1)
FLAT = sensor_family("flat_pad").parameters()


class Stopped(Exception):
    pass


@contextmanager
def answers_of(name: str) -> Iterator[DesignAnswers]:
    with closing(DesignAnswers(sensor_family(name))) as answers:
        yield answers


def pieces_until(
    answers: DesignAnswers, choice: Choice, last: str
) -> tuple[list[str], DesignAnswer]:
    found: list[tuple[str, DesignAnswer]] = []

    def listen(piece: str, answer: DesignAnswer) -> None:
        found.append((piece, answer))
        if piece == last:
            raise Stopped

    with pytest.raises(Stopped):
        answers.answer(choice, listen)
    return [piece for piece, _ in found], found[-1][1]


def modulus(answer: DesignAnswer) -> float:
    return float(answer.parameters.values()["young_modulus_mpa"])


@pytest.mark.thorough
def test_pieces_come_in_order_and_a_softer_gel_scales_the_press_that_is_known():
    with answers_of("flat_pad") as answers:
        pieces, first = pieces_until(answers, Choice({}, PRESS), "quick")
        softer = Choice({"young_modulus_mpa": modulus(first) / 2}, PRESS)
        _, soft = pieces_until(answers, softer, "quick")
    assert [one for one in pieces if one != "step"] == ["formula", "solid", "quick"]
    assert soft.quick.force_n == pytest.approx(first.quick.force_n / 2, rel=1e-12)
    assert soft.quick.positions_m is first.quick.positions_m
    # That scaling is what a simulation gives.
    simulated = press_ball(soft.parameters, soft.press, quick=True, superseded=lambda: False)
    assert soft.quick.force_n == pytest.approx(simulated.force_n, rel=2e-3)
    # The formula, for a flat pad with friction left out, is near.
    assert first.formula_n == pytest.approx(first.quick.force_n, rel=0.2)
    assert first.quality.min_dihedral_deg > 5


@pytest.mark.thorough
def test_the_press_of_the_catalogue_is_kept_between_runs(tmp_path, monkeypatch):
    with answers_of("flat_pad") as answers:
        _, found = pieces_until(answers, Choice({}), "quick")
    assert isinstance(found.quick.mesh, QuadraticMesh)
    monkeypatch.setenv("WARP_CACHE_PATH", str(wp.config.kernel_cache_dir))
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    kept_press(_press_key(found, False)).write(found.quick)
    with answers_of("flat_pad") as answers:
        pieces, again = pieces_until(answers, Choice({}), "solid")
        _, softer = pieces_until(answers, Choice({"young_modulus_mpa": 0.05}), "solid")
        other, _ = pieces_until(answers, Choice({"thickness_mm": 4.5}), "solid")
    assert pieces == ["formula", "exact", "solid"] and other == ["formula", "solid"]
    kept = again.exact
    assert kept.force_n == found.quick.force_n
    for name in ("positions_m", "pressures_pa", "forces_n", "von_mises_pa", "ball_mm"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(found.quick, name))
    for name in ("nodes_m", "tets", "faces", "face_regions"):
        np.testing.assert_array_equal(getattr(kept.mesh, name), getattr(found.quick.mesh, name))
    assert softer.exact.force_n == pytest.approx(kept.force_n * 0.05 / modulus(found))


@pytest.mark.thorough
def test_a_kept_press_knows_all_code_that_makes_it():
    code = "import sys, taccel_lab.viewer.design_press; print(*sys.modules, sep='\\n')"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[1] for name in run.stdout.split() if name.startswith("taccel_lab.")}
    # Messages, files, processes and bounds of parameters move no number.
    loaded -= {"errors", "files", "guards", "lazy_names", "printable"}
    loaded -= {"processes", "profile", "progress", "registration", "summary", "typed", "viewer"}
    assert loaded == {source.removesuffix(".py") for source in SOURCES if "/" not in source}


@pytest.mark.thorough
def test_a_newer_wish_ends_the_work_between_steps():
    asked = []

    def superseded():
        asked.append(True)
        return len(asked) > 1

    with pytest.raises(SupersededError):
        press_ball(FLAT, PRESS, quick=True, superseded=superseded)
    assert len(asked) == 2


@pytest.mark.thorough
def test_a_design_without_light_or_a_drawing_has_all_other_pieces(monkeypatch):
    def no_drawing(name, pad):
        raise InputError("the CAD kernel cannot build this pad")

    monkeypatch.setattr(design_answer, "_drawing", no_drawing)
    dark = Choice({"led_depth_mm": 0.1}, BallPress(3.0, 0.2))
    pieces = []
    with answers_of("9dtact") as answers:
        found = answers.answer(dark, lambda piece, _: pieces.append(piece))
        assert found.quality is not None
        assert found.exact.force_n == pytest.approx(found.quick.force_n, rel=0.14)
        assert set(found.failed) == {"rest", "pressed", "drawing"}
        assert "no light reaches the gel" in found.failed["rest"]
        assert found.missing == [] and "step" in pieces
        words = stage_words(found)
        assert words.startswith("**Done**") and "**No drawing:** the CAD kernel cannot" in words
        assert "| default | " in force_table(found)
        # All of it is known now, without a press, and a softer gel's force is scaled.
        soft = {**dark.overrides, "young_modulus_mpa": 0.5 * modulus(found)}
        again = answers.answer(Choice(soft, dark.press), lambda *_: None)
        assert again.seconds["exact"] < 5
        assert again.exact.force_n == pytest.approx(found.exact.force_n / 2, rel=1e-12)


def test_what_is_worked_on_is_said_with_the_steps_of_the_press():
    answer = DesignAnswer(FLAT, PRESS, formula_n=1.0)
    answer.seconds = {"formula": 0.04, "solid": 0.2}
    answer.exact_steps = (1, 2)
    assert answer.missing == ["quick", "rest", "pressed", "drawing", "exact"]
    assert stage_words(answer) == (
        "*Next: coarse press and press at default accuracy (step 2 of 2) … (0.2 s)*"
    )
    rows = ["| coarse | … | |  |", "| default | … | | step 2 of 2 |"]
    assert force_table(answer).splitlines()[-2:] == rows
    answer.seconds |= {"quick": 0.5, "rest": 0.8, "pressed": 1.0, "drawing": 1.2}
    answer.failed = {"quick": "it did not converge"}
    assert stage_words(answer).splitlines() == [
        "*Next: press at default accuracy (step 2 of 2) … (1.2 s)*",
        "",
        "**No coarse press:** it did not converge",
    ]
    assert "| coarse | none | |  |" in force_table(answer)


def test_presses_stay_within_the_gel_and_domes_have_no_formula():
    assert BallPress(3.0, 2.0).limited(1.0).depth_mm == pytest.approx(0.4)
    assert BallPress(3.0, 0.2).limited(1.0).depth_mm == 0.2
    assert np.isnan(formula_force_n(sensor_family("rtac").parameters(), PRESS))


def test_refusals_are_those_of_the_family():
    with answers_of("digit") as answers, pytest.raises(InputError, match="window_thickness_mm"):
        answers.answer(Choice({"window_thickness_mm": 1e3}), lambda *_: None)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "9dtact"])
def test_the_quick_press_is_as_near_as_the_page_says(name):
    parameters = sensor_family(name).parameters()
    press = PRESS.limited(parameters.pad().thickness_mm)
    quick, exact = (
        press_ball(parameters, press, quick=one, superseded=lambda: False) for one in (True, False)
    )
    assert quick.force_n == pytest.approx(exact.force_n, rel=QUICK_PERCENT / 100)


@pytest.mark.parametrize("name", sorted(sensor_families()))
def test_sliders_reach_the_bounds_of_every_parameter(name):
    for parameter in sensor_family(name).parameters_type.parameters().values():
        if parameter.choices or isinstance(parameter.default, tuple):
            continue
        low, high, step = slider_places(parameter)
        assert low <= parameter.minimum and high == parameter.maximum
        assert low <= parameter.default <= high and 0 < step <= (high - low) / 10
        assert low <= 0 or not parameter.zero_means


def test_undo_and_redo_take_a_dragged_slider_as_one_step():
    now = [0.0]
    history = History(0, clock=lambda: now[0])
    for value in (1, 2, 3):
        history.add(value, "thickness")
        now[0] += 0.1
    history.add(4, "width")
    assert [history.step(way) for way in (-1, -1, -1, 1, 1, 1)] == [3, 0, None, 3, 4, None]
    history.step(-1)
    history.add(5, "width")
    assert history.step(1) is None and history.step(-1) == 3
    # A pause between two changes of one control makes two steps of them.
    for value in (6, 7):
        now[0] += 5
        history.add(value, "width")
    assert [history.step(-1), history.step(-1)] == [6, 3]


def test_labels_units_and_heading_follow_the_values():
    known = sensor_family("gelsight_mini").parameters_type.parameters()
    labels = {
        "mm_per_px": "scale [mm/px]",
        "mm_per_px_y": "scale y [mm/px]",
        "gel_scattering_per_mm": "gel scattering [1/mm]",
        "density_kg_m3": "density [kg/m3]",
        "young_modulus_mpa": "Young's modulus [MPa]",
        "shore_00": "Shore 00",
        "rim_mm": "rim [mm]",
        "width_px": "width [px]",
        "led_lobe": "LED lobe",
    }
    assert {name: known[name].label for name in labels} == labels
    family = sensor_family("flat_pad")
    words = heading(family.label, family.parameters({"thickness_mm": 3.5, "width_px": 200}))
    assert "3.5 mm thick" in words and "image 200 x" in words
    assert stiffness_words(FLAT) == ""
    soft = stiffness_words(family.parameters({"shore_00": 45.0}))
    assert soft.startswith("Overridden by Shore 00 45: 0.") and " MPa (0." in soft


def test_parameters_are_written_below_out_and_read_again(tmp_path):
    family, changed = sensor_family("digit"), {"thickness_mm": 3.2, "thin_crown": "kept"}
    for values in (changed, {}):
        files = export(TOML, family, values, tmp_path / "out")
        assert all(path.is_relative_to(tmp_path / "out") for path in files.values())
        assert read_design(files["parameters"]) == ("digit", values)
    assert command_line(family, changed, Path("out dir")) == (
        "taccel-lab design digit --out 'out dir/everything' --set thickness_mm=3.2 thin_crown=kept"
    )
    # Files of others stay.
    (tmp_path / "parameters").mkdir()
    (tmp_path / "parameters" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.txt"):
        export(TOML, family, {}, tmp_path)


@pytest.mark.parametrize("text", ["x = 1", "sensor = 3", 'sensor = "digit"\nparameters = 1'])
def test_other_files_are_no_designs(text, tmp_path):
    (tmp_path / "design.toml").write_text(text)
    with pytest.raises(InputError, match="is no design"):
        read_design(tmp_path / "design.toml")


def test_what_is_downloaded_is_the_file_or_a_zip_of_several(tmp_path):
    (tmp_path / "pad").mkdir()
    files = [tmp_path / "pad" / name for name in ("pad.step", "pad.stl")]
    for file in files:
        file.write_text(file.name)
    assert packed(files[:1], tmp_path) == ("pad.step", b"pad.step")
    os.utime(files[1], (0, 0))  # Where no clock is set, 1970 is now.
    name, content = packed(files, tmp_path)
    assert name == "pad.zip"
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.namelist() == ["pad/pad.step", "pad/pad.stl"]


def test_wishes_between_are_left_out_and_the_work_at_hand_hears_of_it():
    began, go_on = threading.Event(), threading.Event()
    done = []

    def work(wish, superseded):
        if wish == 0:
            began.set()
            assert go_on.wait(10)
        done.append((wish, superseded()))

    queue = NewestFirst(work)
    queue.ask(0)
    assert began.wait(10) and not queue.wait(0.01)
    for wish in range(1, 50):
        queue.ask(wish)
    go_on.set()
    assert queue.wait(10) and done == [(0, True), (49, False)]
    queue.close()


def test_closing_ends_the_work_at_hand_and_drops_what_waits():
    began, heard, wishes = threading.Event(), threading.Event(), []

    def work(wish, superseded):
        wishes.append(wish)
        began.set()
        while not superseded():
            pass
        heard.set()

    queue = NewestFirst(work)
    queue.ask(1)
    assert began.wait(10)
    queue.close()
    assert heard.is_set()
    queue.ask(2)
    assert wishes == [1]


def answer_of(beside: BackgroundPress) -> PressAnswer:
    limit = time.monotonic() + 120
    while time.monotonic() < limit:
        if (found := beside.poll(0.1)) is not None:
            return found
    raise AssertionError("no answer within two minutes")


def process_of(beside: BackgroundPress) -> int:
    assert beside._child is not None
    return beside._child._process.pid


@pytest.mark.thorough
def test_the_newest_press_is_the_one_of_this_process_to_the_bit_and_a_dead_process_is_named():
    with closing(BackgroundPress()) as beside:
        # Older wishes never come, also those whose press is under way.
        beside.begin(FLAT, BallPress(3.0, 0.6))
        while beside.steps == (0, 0):
            assert beside.poll(0.1) is None
        assert beside.steps == (0, 3)
        for depth in (0.3, 0.4, 0.5, SHORT.depth_mm):
            beside.begin(FLAT, BallPress(3.0, depth))
        found = answer_of(beside)
        assert beside.steps == (0, 1)
        steps = []
        here = press_ball(
            FLAT, SHORT, quick=False, superseded=lambda: False, step=lambda *at: steps.append(at)
        )
        assert steps == [(0, 1)]
        assert (found.force_n, found.error_n) == (here.force_n, here.error_n)
        np.testing.assert_array_equal(found.positions_m, here.positions_m)
        assert beside.poll() is None

        # What kills the process costs its press alone.
        beside.begin(FLAT, BallPress(3.0, 0.6))
        first = process_of(beside)
        os.kill(first, signal.SIGKILL)
        with pytest.raises(SimulationError, match="ended by signal 9"):
            answer_of(beside)
        beside.begin(FLAT, SHORT)
        assert answer_of(beside).force_n == here.force_n and process_of(beside) != first


def test_closing_ends_a_press_under_way():
    beside = BackgroundPress()
    beside.begin(FLAT, BallPress(3.0, 0.6))
    process = process_of(beside)
    os.kill(process, 0)  # An error, were there no such process.
    beside.close()
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
    assert beside.poll() is None
    beside.close()
