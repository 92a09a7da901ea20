"""A problem that the first rank alone has read is distributed whole, and the answers are those of one process."""

import sys
from pathlib import Path

import numpy as np

import contactqp as cq
from contactqp.distributed.distributing import distribute, problem_from_share, rows_of_problem, share_from_first_rank
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.solving import collected, solve_distributed
from contactqp.linalg.measures import bodies

ranks = Ranks()
# Of products with rows of some hundred entries; and what answers may differ by.
ROUNDING, ANSWERS = 1e-13, 1e-9
PARTS = ("displacement", "normal_force", "tie_force", "contact_status")


def close(found, wanted, what, tolerance=ROUNDING):
    size = np.max(np.abs(wanted), initial=0.0)
    assert found.shape == np.shape(wanted), f"{what}: {found.shape} and {np.shape(wanted)}"
    assert np.max(np.abs(found - wanted), initial=0.0) <= tolerance * size, f"{what}: off"


def distributed(path):
    whole = rows_of_problem(cq.read_problem(path)) if ranks.rank == 0 else None
    return problem_from_share(ranks, share_from_first_rank(whole, ranks))


def compare(d, one):
    n, m, k = one.dimension, one.contacts, one.ties

    def whole(values):
        return d.gathered(values, d.dof_number)

    assert d.dimension == n
    for numbers, count in ((d.dof_number, n), (d.contact_number, m), (d.tie_number, k)):
        assert np.array_equal(d.gathered(numbers, numbers), np.arange(count)), "each has one rank"
    u, force, tied = (np.random.default_rng(i).standard_normal(count) for i, count in enumerate((n, m, k)))
    here = u[d.dof_number]
    close(whole(d.product(here)), one.stiffness @ u, "K u")
    close(whole(d.diagonal), one.stiffness.diagonal(), "diagonal of K")
    close(whole(d.load), one.load, "load")
    close(d.gathered(d.normal.lengths(here), d.contact_number), one.normal @ u, "E_N u")
    close(whole(d.normal.forces(force[d.contact_number])), one.normal.T @ force, "E_N' l")
    close(d.gathered(d.gap, d.contact_number), one.gap, "gap")
    close(d.gathered(d.tie.lengths(here), d.tie_number), one.tie @ u, "A u")
    close(whole(d.tie.forces(tied[d.tie_number])), one.tie.T @ tied, "A' nu")
    close(d.gathered(d.tie_value, d.tie_number), one.tie_value, "b")
    assert np.array_equal(whole(d.body), bodies(one)), "bodies"
    assert d.units == one.units
    for names, numbers, called in (
        (d.dof_name, d.dof_number, one.dof_name),
        (d.contact_name, d.contact_number, one.contact_name),
        (d.tie_name, d.tie_number, one.tie_name),
    ):
        assert [names(i) for i in range(len(numbers))] == [called(int(number)) for number in numbers]
    assert (d.tangent is None) == (one.tangent is None)
    if d.tangent is not None:
        slips = d.tangent.lengths(here).reshape(d.slip_origin.shape)
        close(d.gathered(slips, d.contact_number), (one.tangent @ u).reshape(one.slip_origin.shape), "E_T u")
        close(d.gathered(d.friction, d.contact_number), one.friction, "friction")
        close(d.gathered(d.slip_origin, d.contact_number), one.slip_origin, "slip origin")


def compare_answers(d, one):
    """Of a problem without friction."""
    found, wanted = collected(solve_distributed(d)), cq.solve(one)
    assert found.certificate.passed
    assert found.certificate.violations.penetration.shape == ((one.contacts,) if ranks.rank == 0 else (0,))
    if ranks.rank > 0:
        assert not any(len(getattr(found, part)) for part in PARTS), "the first rank alone has the answer"
        return
    assert np.array_equal(found.contact_status == "open", wanted.contact_status == "open")
    close(found.displacement, wanted.displacement, "displacement", ANSWERS)
    # Each force may not be unique, what they do together is.
    together, theirs = (one.normal.T @ x.normal_force + one.tie.T @ x.tie_force for x in (found, wanted))
    close(together, theirs, "contact and tie forces", ANSWERS)


spoiled = "--spoil" in sys.argv
for path in sys.argv[1 + spoiled :]:
    one, part = cq.read_problem(path), distributed(path)
    if spoiled and ranks.rank == ranks.size - 1:
        part.load[:1] += 1e-9 * np.abs(one.load).max()
    compare(part, one)
    compare(distribute(one, ranks), one)  # the same of what all have
    if not one.frictional:
        compare_answers(part, one)
    if ranks.rank == 0:
        print(f"{Path(path).name}: the same on {ranks.size}", flush=True)
