# SPDX-License-Identifier: Apache-2.0
"""What to press next follows what is there."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.capture.coverage import CELLS, cell_of
from taccel_lab.calibration.record.advice import SHARES, contact_radius_mm, next_press

SIZE = (320, 240)


@given(st.integers(0, 47))
def test_whoever_follows_it_covers_all_cells_at_all_depths(count: int) -> None:
    circles = []
    for _ in range(count):
        advice = next_press(circles, SIZE, 40.0)
        u, v = ((advice.cell[k] + 0.5) * SIZE[k] / CELLS[k] for k in (0, 1))
        assert advice.radius_px is not None
        circles.append(ContactCircle(u, v, advice.radius_px))
    cells = [cell_of(circle, *SIZE) for circle in circles]
    each = [cells.count(cell) for cell in {(c, r) for c in range(4) for r in range(3)}]
    assert max(each) - min(each) <= 1
    if count >= 36:
        here = {circle.radius_px for circle in circles if cell_of(circle, *SIZE) == (0, 0)}
        assert here == {share * 40.0 for share in SHARES}


def test_without_a_scale_the_depth_is_told_by_the_contacts_so_far() -> None:
    assert next_press([], SIZE, None).radius_px is None
    assert "px wide" in str(next_press([ContactCircle(30, 30, 20)], SIZE, None))


def test_a_balls_contact_is_never_wider_than_the_ball() -> None:
    assert contact_radius_mm(2.0, 5.0) == 2.0 and contact_radius_mm(2.0, 0.5) < 2.0
