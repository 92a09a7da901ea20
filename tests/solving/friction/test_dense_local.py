"""Local problems whose contacts all feel each other: what is read from the dense operator, and what that costs."""

from __future__ import annotations

import time

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.solving.friction.gauss_seidel import colours, own_blocks


@pytest.mark.parametrize(("contacts", "width", "density"), [(0, 3, 1.0), (5, 2, 1.0), (30, 3, 0.02), (40, 2, 0.01)])
def test_colours_and_blocks_of_a_dense_operator_are_those_of_its_sparse_form(
    contacts: int, width: int, density: float
) -> None:
    random, size = np.random.default_rng(3), width * contacts
    W = random.standard_normal((size, size)) * (random.random((size, size)) <= density)
    groups, same = (colours(form, contacts, width) for form in (W, sp.csr_array(W)))
    assert [group.tolist() for group in groups] == [group.tolist() for group in same]
    blocks = own_blocks(W, contacts, width)
    assert np.array_equal(blocks, own_blocks(sp.csr_array(W), contacts, width))
    assert all(np.array_equal(blocks[i], W[width * i :, width * i :][:width, :width]) for i in range(contacts))


def test_a_dense_operator_is_not_coloured_entry_by_entry() -> None:
    """With 1500 contacts that took three times a time limit of one second; measured a thirtieth of a product here."""
    W, taken = np.ones((1500, 1500)), list[float]()
    for call in (lambda: W @ W, lambda: (colours(W, 500, 3), own_blocks(W, 500, 3))):
        began = time.process_time()
        call()
        taken.append(time.process_time() - began)
    assert taken[1] < taken[0]


@pytest.mark.parametrize("width", [2, 3])
def test_compliances_of_contacts_are_the_largest_of_their_blocks(width: int) -> None:
    H = np.random.default_rng(5).integers(-9, 10, (width * 4, width * 4)).astype(float)
    W = sp.csr_array(np.where(abs(H + H.T) > 4, H + H.T, 0.0) + 100.0 * np.eye(width * 4))
    problem = cq.LocalProblem(delassus=W, offset=np.ones(width * 4), friction=0.5, dimension=width)
    blocks = [abs(W.toarray()[width * i : width * (i + 1), width * i : width * (i + 1)]) for i in range(4)]
    assert problem.own_compliances.tolist() == [[b[0, 0] for b in blocks], [b[1:, 1:].max() for b in blocks]]
