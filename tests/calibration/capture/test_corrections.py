# SPDX-License-Identifier: Apache-2.0
"""The file with which a person corrects contacts."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import ContactCircle, load_captures
from taccel_lab.calibration.capture.load import override_presses, override_text
from taccel_lab.calibration.circles.labels import choose_circles
from taccel_lab.cli.capture import CaptureCheckCommand
from taccel_lab.errors import InputError
from tests.calibration.circles.presses import (
    BALL_MM,
    GRID,
    contacts_of,
    gel,
    press_set,
    pressed,
    scattered,
)
from tests.calibration.drawn.faults import add_noise, quantise
from tests.support.synthetic_presses import write_folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Five presses on disk, one of them empty, one with a label far off."""
    rng = np.random.default_rng(0)
    circles = scattered(5, seed=8)
    images, labels = {}, {}
    for i, circle in enumerate(circles):
        image = gel() if i == 2 else pressed(circle)
        images[f"p{i}"] = quantise(add_noise(image, 1.0, rng))
        if i != 2:
            labels[f"p{i}"] = dataclasses.replace(circle, u_px=circle.u_px + (12 if i == 3 else 0))
    return write_folder(tmp_path / "captures", quantise(gel()), images, labels, BALL_MM, GRID)


@pytest.mark.thorough
def test_check_then_correct(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "page"
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
    found = contacts_of(captures)
    for which in ("fused", "labels", "detected"):
        assert choose_circles(captures, found, which)[2] == ContactCircle(70.5, 60.25, 15.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[[contact]]\npress = "nobody"\nskip = true', "names nobody, which is no press"),
        ('[[contact]]\npress = "p0"\nu_px = 3.0', "go together"),
        ('[[contact]]\npress = "p0"\n[[contact]]\npress = "p0"', "p0 appears twice"),
        ('[[contact]]\npress = "p0"\nradius = 3.0', "contact.0.radius"),
        ("[[contact", "not valid TOML"),
        ('[[contact]]\npress = "p0"\nu_px = nan\nv_px = 1.0\nradius_px = 2.0', "finite"),
        (
            "\n".join(f'[[contact]]\npress = "p{i}"\nskip = true' for i in range(3)),
            "leaves out every press",
        ),
    ],
)
def test_bad_corrections(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "contacts.toml"
    path.write_text(text)
    circles = scattered(3)
    captures = press_set(circles, [gel()] * 3)
    with pytest.raises(InputError, match=message):
        override_presses(captures.presses, path)


def test_names_with_odd_characters_survive(tmp_path: Path) -> None:
    circles = scattered(2)
    captures = press_set(circles, [pressed(c) for c in circles])
    odd = tuple(
        dataclasses.replace(press, name=name)
        for press, name in zip(captures.presses, ('a "b" \\ c', "ü#[]"), strict=True)
    )
    captures = dataclasses.replace(captures, presses=odd)
    text = override_text(captures.source, [(p.name, p.circle, "sure") for p in odd])
    edited = tmp_path / "contacts.toml"
    # The user takes away the # of every line with a value.
    body = text.split("\n\n", 1)[1]
    lines = [line.removeprefix("# ") for line in body.splitlines()]
    kept = "\n".join(line for line in lines if line != "sure")
    edited.write_text(kept, encoding="utf-8")
    back = override_presses(captures.presses, edited)
    assert all(press.checked for press in back)
    for press, circle in zip(back, circles, strict=True):
        assert press.circle is not None and press.circle.center_gap_px(circle, GRID) < 0.01
