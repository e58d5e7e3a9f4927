# SPDX-License-Identifier: Apache-2.0
"""Muon: torch's own takes the same steps, members of an ensemble do not see each other."""

from __future__ import annotations

import pytest
import torch

from taccel_lab.calibration.response.training import MOMENTUM, Muon, nearly_orthogonal


def gradients(*shape: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(3))


@pytest.mark.parametrize("shape", [(4, 64, 64), (2, 64, 27), (9, 40), (1, 6)])
def test_directions_stay_and_singular_values_come_near_to_one(shape: tuple[int, ...]) -> None:
    given = gradients(*shape)
    left, _, right = torch.linalg.svd(given, full_matrices=False)
    turned = left.mT @ nearly_orthogonal(given) @ right.mT
    sizes = turned.diagonal(dim1=-2, dim2=-1)
    torch.testing.assert_close(turned, torch.diag_embed(sizes), rtol=0, atol=1e-3)
    # The published range; tiny singular values, which square matrices have, take more iterations.
    assert sizes.max() < 1.25
    assert sizes.median() > 0.65


@pytest.mark.skipif(not hasattr(torch.optim, "Muon"), reason="torch before 2.9 has no Muon")
@pytest.mark.parametrize("shape", [(12, 30), (30, 12), (64, 64)])
def test_torchs_own_takes_the_same_steps(shape: tuple[int, int]) -> None:
    ours, theirs = (torch.zeros(shape, requires_grad=True) for _ in range(2))
    our = Muon([ours], 0.1)
    their = torch.optim.Muon([theirs], 0.1, weight_decay=0.0, momentum=MOMENTUM)
    for gradient in gradients(3, *shape):
        for weight, optimizer in ((ours, our), (theirs, their)):
            weight.grad = gradient.clone()
            optimizer.step()
    # Theirs counts with 8 bits.
    assert (ours - theirs).norm() < 0.02 * theirs.norm()


def test_members_of_an_ensemble_step_alone() -> None:
    together = torch.zeros(3, 8, 5, requires_grad=True)
    alone = torch.zeros(8, 5, requires_grad=True)
    steps = gradients(2, 3, 8, 5)
    for weight, part in ((together, slice(None)), (alone, 1)):
        optimizer = Muon([weight], 0.1)
        for step in steps:
            weight.grad = step[part].clone()
            optimizer.step()
    torch.testing.assert_close(together[1], alone)
