# SPDX-License-Identifier: Apache-2.0
"""Forces of gels that relax: the recursion against its integral, readings against presses."""

from __future__ import annotations

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.presses.press import Press
from taccel_lab.profile import BranchEntry, SensorProfile
from taccel_lab.reading.overstress import Overstress
from taccel_lab.reading.pressure import ContactPressure, PressureReader
from taccel_lab.reading.touch import touch_of
from taccel_lab.sensors.profile import catalogue_profile

BRANCHES = ((0.4, 2.0), (0.2, 0.3))
SIGMA_M = 5e-6


def test_the_recursion_is_the_integral() -> None:
    """Of a pressure that grows, rests and falls in straight lines, at uneven times."""
    times = np.array([0.0, 0.1, 0.15, 0.8, 1.0, 3.0, 3.2, 9.0])
    values = np.array([0.0, 1.0, 1.5, 2.0, 2.0, 2.0, 0.5, 0.5])
    rates, made = np.diff(values) / np.diff(times), Overstress(BRANCHES)
    for number, (time, value) in enumerate(zip(times, values, strict=True)):
        found, unknown = made.follow(np.full((2, 3), value), float(time))
        expected = sum(
            modulus * tau * (rates * np.diff(np.exp((times - time) / tau)))[:number].sum()
            for modulus, tau in BRANCHES
        )
        np.testing.assert_allclose(found, expected, atol=1e-12)
        assert unknown == 0


def test_what_a_first_frame_leaves_open_fades() -> None:
    made, pressure = Overstress(BRANCHES), np.full((2, 2), 3.0)
    found, unknown = made.follow(pressure, 10.0)
    np.testing.assert_allclose(found, 0.5 * made.most * pressure)
    assert unknown == pytest.approx(0.5 * made.most * 12.0)
    found, unknown = made.follow(pressure, 12.0)
    left = sum(0.5 * modulus * np.exp(-2.0 / tau) for modulus, tau in BRANCHES)
    np.testing.assert_allclose(found, left * pressure)
    assert unknown == pytest.approx(left * 12.0)
    # Without its time a frame is a first one, whatever was before.
    assert made.follow(pressure, None)[1] == made.follow(pressure, 20.0)[1] > unknown


@pytest.fixture(scope="module")
def gel() -> SensorProfile:
    values = {
        "thickness_mm": 4.0, "length_x_mm": 24.0, "length_y_mm": 24.0, "young_modulus_mpa": 0.3,
        "width_px": 120, "height_px": 90, "mm_per_px": 0.12,
    }  # fmt: skip
    profile = catalogue_profile("flat_pad", values)
    branches = tuple(BranchEntry(relative_modulus=g, time_s=tau) for g, tau in BRANCHES)
    known = profile.material.provenance.model_copy(
        update={"spread": {"young_modulus_pa": 0.01 * profile.material.young_modulus_pa}}
    )
    return profile.with_block(profile.material.replace(branches=branches, provenance=known))


@pytest.fixture(scope="module")
def held(gel: SensorProfile) -> Press:
    """Down at 0.5 mm/s, 5 s of rest, and back."""
    return tl.press(
        gel, "sphere:4", depth_mm=0.5, step_mm=0.25, speed_mm_s=0.5, hold_s=5.0, unload=True,
        friction=0.0, accuracy="fast", states=True,
    )  # fmt: skip


def readings(gel: SensorProfile, held: Press, timed: bool) -> list[ContactPressure]:
    """Of all states of a press."""
    reader, grid = PressureReader(gel, gel.grid()), gel.grid()
    sigma = np.full((grid.height_px, grid.width_px), SIGMA_M)
    states = held.states
    assert states is not None

    def read(rise: np.ndarray, time_s: float | None) -> ContactPressure:
        return reader.read(rise, touch_of(rise, sigma, grid), sigma, sigma, time_s)

    if timed:
        read(np.zeros(sigma.shape), 0.0)
    return [
        read(seen.height_m - seen.rest_height_m, step.time_s if timed else None)
        for step, seen in zip(held.steps, states.surfaces, strict=True)
    ]


def width(found: ContactPressure, true_n: float) -> float:
    """Ratio of the ends of an interval, which holds the force."""
    assert found.force_interval_n is not None
    low, high = found.force_interval_n
    assert low <= true_n <= high
    return high / low if low > 0 else np.inf


@pytest.mark.thorough
def test_an_image_with_its_time_reads_the_force_of_a_hold_alone_the_sudden_and_the_long_one(
    gel: SensorProfile, held: Press
) -> None:
    """Of an image alone the interval is wider by what time may have done."""
    true = np.array([step.wrench[2] for step in held.steps])
    timed, alone = (readings(gel, held, timed=each) for each in (True, False))
    widths = [width(one, force) for one, force in zip(timed, true, strict=True)]
    assert not any("held" in text for one in timed for text in one.remarks)
    read, pressed = np.array([one.force_n for one in timed]), true > 0.3 * true.max()
    np.testing.assert_allclose(read[pressed], true[pressed], rtol=0.06)
    assert read[-1] < 0.1 * read.max(), "the dent that is left needs no force"
    rests = len(held.path.way_there()) + 8
    for one, force, known in list(zip(alone, true, widths, strict=True))[:rests]:
        assert width(one, force) > 1.3 * known
        assert any("1.6 times the force of a long one" in text for text in one.remarks)
