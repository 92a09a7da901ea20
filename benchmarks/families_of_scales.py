"""Contacts of very different scales: one far beyond the rest, and every contact in a unit of its own.

`friction_families` has the same with Coulomb's friction.
"""

from __future__ import annotations

from benchmarks.bricks import Generator, chain, fair_gaps, units, with_rows
from benchmarks.families_of_stiffness import chain_walls
from benchmarks.family_register import member
from contactqp import ContactProblem


@member(well_posed=True)
def far_gap(rng: Generator) -> ContactProblem:
    """Grounded chains with near walls and one or two a thousand to a million times as far, on the same unknowns."""
    n = int(rng.integers(3, 12))
    K = chain(10.0 ** rng.uniform(0, 4, n), True)
    f = rng.normal(size=n)
    at = rng.choice(n, min(n, int(rng.integers(1, 6))), replace=False)
    E = units(n, at, rng.choice([-1.0, 1.0], len(at)))
    near = ContactProblem(K, f, E, fair_gaps(rng, K, f, E))
    far = rng.choice(n, int(rng.integers(1, 3)))
    return with_rows(near, units(n, far, rng.choice([-1.0, 1.0], len(far))), 10.0 ** rng.uniform(3, 6, len(far)))


@member(well_posed=True)
def scaled_contact(rng: Generator) -> ContactProblem:
    """Chains whose contacts have units of their own: row and gap times a power of two from 1e-8 to 1e8."""
    base = chain_walls(rng)
    factor = 2.0 ** rng.integers(-26, 27, base.contacts)
    return base.replace(normal=base.normal.toarray() * factor[:, None], gap=base.gap * factor)
