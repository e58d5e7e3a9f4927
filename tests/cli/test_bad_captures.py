# SPDX-License-Identifier: Apache-2.0
"""Captures that ``taccel-lab calibrate color`` refuses, and its bad options."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.small_captures import background, refuse, write_image

Change = Callable[[Path], None]


def edit(old: str, new: str) -> Change:
    def change(folder: Path) -> None:
        manifest = folder / "captures.toml"
        text = manifest.read_text()
        assert old in text
        manifest.write_text(text.replace(old, new, 1))

    return change


def remove(name: str) -> Change:
    return lambda folder: (folder / name).unlink()


def empty(folder: Path) -> None:
    for path in folder.iterdir():
        path.unlink()


def no_presses(folder: Path) -> None:
    manifest = folder / "captures.toml"
    text = manifest.read_text().split("[[presses]]")[0]
    manifest.write_text(text.replace("[indenter]", "presses = []\n[indenter]"))


def other_size(folder: Path) -> None:
    write_image(folder / "p2.png", background()[:60])


def frame_without_contact(folder: Path) -> None:
    noise = np.random.default_rng(1).normal(0, 0.7, background().shape)
    write_image(folder / "p2.png", np.rint(background() + noise).clip(0, 255).astype(np.uint8))


def truncated_image(folder: Path) -> None:
    (folder / "p2.png").write_bytes((folder / "p2.png").read_bytes()[:200])


CAPTURES: dict[str, tuple[Change, list[str]]] = {
    "missing folder": (
        shutil.rmtree,
        [r"captures does not exist", r"capture folder with captures\.toml"],
    ),
    "empty folder": (empty, [r"captures: an empty folder", r"holds captures\.toml"]),
    "no manifest": (remove("captures.toml"), [r"captures: no manifest"]),
    "no background": (remove("background.png"), [r"captures/background\.png does not exist"]),
    "background not named": (
        edit('background = "background.png"\n', ""),
        [r"captures\.toml: no background; give an image of the untouched sensor"],
    ),
    "missing image": (remove("p2.png"), [r"captures/p2\.png does not exist"]),
    "truncated image": (
        truncated_image,
        [r"p2\.png is not an image.*PNG, JPEG, .* allowed"],
    ),
    "no presses": (no_presses, [r"captures\.toml holds no presses", r"at least one image"]),
    "sizes differ": (
        other_size,
        [r"p2\.png is 96x60 px but the background .*background\.png is 96x72 px", r"one size"],
    ),
    "frame without contact": (frame_without_contact, [r"p2\.png: no contact found"]),
    "NaN label": (
        edit("u_px = 33.0", "u_px = nan"),
        [r"captures\.toml: presses\.2\.contact\.u_px", "finite"],
    ),
    "infinite label": (
        edit("radius_px = 11.0", "radius_px = inf"),
        [r"captures\.toml: presses\.2\.contact\.radius_px", "finite"],
    ),
    "circle outside the image": (
        edit("u_px = 33.0", "u_px = 103.0"),
        [r"p2\.png: the contact circle at \(103, 44\) px .*its centre has to be inside"],
    ),
    "circle larger than the ball": (
        edit("radius_px = 11.0", "radius_px = 21.0"),
        [r"p2\.png: contact radius 21 px is 2\.100 mm .*more than the ball's radius of 2 mm"],
    ),
    "scale 0": (edit("mm_per_px_x = 0.1", "mm_per_px_x = 0.0"), ["mm_per_px_x", "0.0001"]),
    "negative scale": (edit("mm_per_px_y = 0.1", "mm_per_px_y = -0.1"), ["mm_per_px_y", "0.0001"]),
    "view past the pad": (
        lambda folder: [
            edit("mm_per_px_x = 0.1", "mm_per_px_x = 0.3")(folder),
            edit("mm_per_px_y = 0.1", "mm_per_px_y = 0.3")(folder),
            edit("radius_mm = 2.0", "radius_mm = 6.0")(folder),
        ][0],
        [r"captures\.toml: at 0\.3 x 0\.3 mm/px", r"pad of 24 x 20 mm"],
    ),
    "ball of no size": (edit("radius_mm = 2.0", "radius_mm = 0"), [r"indenter\.radius_mm"]),
    "NaN ball": (edit("radius_mm = 2.0", "radius_mm = nan"), [r"indenter\.radius_mm", "finite"]),
    "unknown key": (
        edit('source = "', 'sauce = "'),
        [r"captures\.toml: sauce: unknown key; allowed: .*source"],
    ),
    "newer manifest": (
        edit("schema_version = 1", "schema_version = 3"),
        [r"captures\.toml: schema_version", "input should be 1 or 2"],
    ),
    "unknown sensor": (edit('"gelsight"', '"gelsite"'), ["gelsite", "gelsight"]),
    "broken TOML": (edit("[indenter]", "[indenter"), [r"captures\.toml is not valid TOML"]),
}


@pytest.mark.parametrize("case", CAPTURES)
def test_bad_captures(here: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    change, words = CAPTURES[case]
    change(here / "captures")
    # The labelled circles as they are: fused with those found, a wrong label would be outvoted.
    refuse(
        ["calibrate", "color", "captures", "--circles", "labels"],
        words,
        capsys,
        ("earlier_profile",),
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--steps", "0"], ["steps must be at least 1, got 0"]),
        (["--steps", "-5"], ["steps must be at least 1, got -5"]),
        (["--ensemble", "1"], ["ensemble must be 0 or at least 2, got 1"]),
        (["--ensemble", "-1"], ["ensemble must be 0 or at least 2, got -1"]),
        (["--holdout-every", "1"], ["holdout_every must be 0 or at least 2, got 1"]),
        (["--holdout-every", "6"], [r"captures\.toml holds 5 presses, too few to hold out"]),
        (["--base", "absent"], [r"absent/profile\.toml: no such profile folder"]),
    ],
)
def test_bad_options_of_calibrate(
    here: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: list[str]
) -> None:
    command = ["calibrate", "color", "captures", *options]
    refuse(command, words, capsys, ("new/out",))
