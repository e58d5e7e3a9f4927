# SPDX-License-Identifier: Apache-2.0
"""The file with which a person corrects contacts."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import ContactCircle, load_captures
from taccel_lab.calibration.capture.contacts_file import override_presses, override_text
from taccel_lab.calibration.circles.labels import choose_circles
from taccel_lab.cli.capture import CaptureCheckCommand
from taccel_lab.errors import InputError
from tests.calibration.circles import presses as drawn
from tests.calibration.drawn.faults import add_noise, quantise
from tests.support.synthetic_presses import write_folder


@pytest.mark.thorough
def test_check_then_correct(tmp_path: Path) -> None:
    """Five presses on disk, one of them empty, one with a label far off."""
    rng = np.random.default_rng(0)
    images, labels = {}, {}
    for i, circle in enumerate(drawn.scattered(5, seed=8)):
        image = drawn.gel() if i == 2 else drawn.pressed(circle)
        images[f"p{i}"] = quantise(add_noise(image, 1.0, rng))
        if i != 2:
            labels[f"p{i}"] = replace(circle, u_px=circle.u_px + (12 if i == 3 else 0))
    rest, out = quantise(drawn.gel()), tmp_path / "page"
    folder = write_folder(tmp_path / "set", rest, images, labels, drawn.BALL_MM, drawn.GRID)
    with pytest.raises(SystemExit) as stopped:
        CaptureCheckCommand(folder, report=out).run()
    assert stopped.value.code == 1
    rows = {row["name"]: row for row in json.loads((out / "report.json").read_text())["presses"]}
    assert not rows["p2"]["found"] and "no contact found" in rows["p2"]["fault"]
    assert rows["p3"]["label_center_px"] == pytest.approx(12.0, abs=1.5)
    # The file as written leaves the empty frame out, and nothing else changes.
    text = (out / "contacts.toml").read_text()
    assert text.index('press = "p2"') < text.index('press = "p3"') < text.index('press = "p0"')
    (folder / "contacts.toml").write_text(text)
    captures = load_captures(folder)
    assert [press.name for press in captures.presses] == ["p0", "p1", "p3", "p4"]
    assert "contacts_sha256" in captures.provenance
    assert not any(press.checked for press in captures.presses)
    # A corrected circle wins over label and detection.
    (folder / "contacts.toml").write_text(
        '[[contact]]\npress = "p2"\nskip = true\n'
        '[[contact]]\npress = "p3"\nu_px = 70.5\nv_px = 60.25\nradius_px = 15.0\n'
    )
    captures = load_captures(folder)
    found = drawn.contacts_of(captures)
    for which in ("fused", "labels", "detected"):
        assert choose_circles(captures, found, which)[2] == ContactCircle(70.5, 60.25, 15.0)


@pytest.mark.parametrize(("rows", "message"), [
    (['"nobody"\nskip = true'], "names nobody, which is no press"),
    (['"p0"\nu_px = 3.0'], "go together"),
    (['"p0"', '"p0"'], "p0 appears twice"),
    (['"p0"\nradius = 3.0'], "contact.0.radius"),
    (['"p0"\n[[contact'], "not valid TOML"),
    (['"p0"\nu_px = nan\nv_px = 1.0\nradius_px = 2.0'], "finite"),
    ([f'"p{i}"\nskip = true' for i in range(3)], "leaves out every press"),
])  # fmt: skip
def test_bad_corrections(tmp_path: Path, rows: list[str], message: str) -> None:
    path = tmp_path / "contacts.toml"
    path.write_text("\n".join(f"[[contact]]\npress = {row}" for row in rows))
    captures = drawn.press_set(drawn.scattered(3), [drawn.gel()] * 3)
    with pytest.raises(InputError, match=message):
        override_presses(captures.presses, path)


def test_names_with_odd_characters_survive(tmp_path: Path) -> None:
    circles = drawn.scattered(2)
    captures = drawn.press_set(circles, [drawn.pressed(c) for c in circles])
    names = ('a "b" \\ c', "ü#[]")
    odd = [replace(p, name=name) for p, name in zip(captures.presses, names, strict=True)]
    text = override_text(captures.source, [(p.name, p.circle, "sure") for p in odd])
    # The user takes away the # of every line with a value.
    lines = [line.removeprefix("# ") for line in text.split("\n\n", 1)[1].splitlines()]
    edited = tmp_path / "contacts.toml"
    edited.write_text("\n".join(line for line in lines if line != "sure"), encoding="utf-8")
    for press, circle in zip(override_presses(tuple(odd), edited), circles, strict=True):
        assert press.checked and press.circle is not None
        assert press.circle.center_gap_px(circle, drawn.GRID) < 0.01
