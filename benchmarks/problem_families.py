"""Seeded families of contact problems that methods get wrong.

`family(name, seed)` gives the same problem every time. Numbers are floats and mean what they say: a floating body's
stiffness is singular exactly, not to rounding, because its springs have so few bits that their sums are exact. That
every problem has (or has not) a solution is by construction; each maker says how.
"""

# Importing the files registers what they hold.
from benchmarks import (
    families_of_constraints,
    families_of_contacts,
    families_of_decay,
    families_of_floating_bodies,
    families_of_printing,
    families_of_programs,
    families_of_rigid_answers,
    families_of_scales,
    families_of_stacks,
    families_of_stiffness,
)
from benchmarks.family_register import FAMILIES, Family, family

__all__ = [
    "FAMILIES",
    "Family",
    "families_of_constraints",
    "families_of_contacts",
    "families_of_decay",
    "families_of_floating_bodies",
    "families_of_printing",
    "families_of_programs",
    "families_of_rigid_answers",
    "families_of_scales",
    "families_of_stacks",
    "families_of_stiffness",
    "family",
]
