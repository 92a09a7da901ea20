"""Problems that other people published with their solvers, read where the environment says that they lie.

CONTACTQP_FRICTION_DATA names the folder: test data of Siconos's numerics component and a sample of FCLIB's library.
The numbers are those of an independent survey of the files.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import pytest

FOLDER = os.environ.get("CONTACTQP_FRICTION_DATA")
needs_data = pytest.mark.skipif(
    FOLDER is None, reason="CONTACTQP_FRICTION_DATA is not set: no published problems to read"
)


class Survey(NamedTuple):
    dimension: int
    contacts: int
    unknowns: int | None  # None: a local file
    friction: float
    offset_size: float  # |q|, three digits
    asymmetry: float  # of W, one digit
    rank: int | None  # eigenvalues of the symmetric part of W above 1e-10 of the largest


SURVEY = {
    "local_problem_test.hdf5": Survey(3, 48, None, 0.7, 0.00981, 2e-16, 72),
    "Box_Stacks-i0122-82-5.hdf5": Survey(3, 82, 450, 0.3, 0.0112, 2e-16, 175),
    "BoxesStack1-i100000-32.hdf5.dat": Survey(3, 52, None, 0.7, 64, 2e-16, 78),
    "Capsules-i100-889.dat": Survey(3, 276, None, 0.7, 6.21, 0.0007, 549),
    "Capsules-i125-1213.hdf5": Survey(3, 286, None, 0.7, 7.08, 0.001, 570),
    "Confeti-ex13-Fc3D-SBM.dat": Survey(3, 107, None, 0.04, 1.81e03, 0, 228),
    "CubeH8.hdf5": Survey(3, 1, 162, 0.3, 0.000303, 1e-12, 3),
    "FC3D_Example1.dat": Survey(3, 3, None, 0.1, 5.74, 0, 9),
    "FrictionContact3D_1c.dat": Survey(3, 1, None, 0.1, 3.74, 0, 3),
    "FrictionContact3D_RR_1c.dat": Survey(3, 1, None, 0.6, 0.325, 0, 3),
    "FrictionContactProblem00031.dat": Survey(2, 11, None, 0.9, 0.236, 2e-17, 22),
    "FrictionContactProblem00071.dat": Survey(2, 89, None, 0.9, 36.6, 5e-17, 178),
    "FrictionContactProblem00237.dat": Survey(2, 376, None, 0.9, 69.4, 4e-17, 751),
    "GFC3D_Example00.dat": Survey(3, 1, 3, 0.1, 1.73, 0, 3),
    "GFC3D_Example00_badly_scaled.dat": Survey(3, 1, 3, 0.1, 1e04, 0, 3),
    "GFC3D_OneContact.dat": Survey(3, 1, 39, 0.5, 0.0549, 1e-14, 3),
    "GFC3D_TwoRods1.dat": Survey(3, 3, 54, 0.1, 1.97, 8e-16, 9),
    "LMGC_GlobalFrictionContactProblem00046.hdf5": Survey(3, 9, 162, 0.3, 0.177, 0.2, 27),
    "NESpheres_10_1.dat": Survey(3, 9, None, 0.8, 3.6, 8e-17, 27),
    "OneObject-i100000-316.hdf5.dat": Survey(3, 25, None, 0.3, 1.83, 5e-05, 49),
    "RockPile_tob1.dat": Survey(3, 463, None, 1.0, 399, 0.002, 743),
    "Rover1039.dat": Survey(3, 4, None, 0.7, 0.422, 9e-06, 12),
    "Rover1040.dat": Survey(3, 5, None, 0.7, 0.916, 9e-06, 14),
    "Rover11035.dat": Survey(3, 1, None, 0.7, 0.197, 1e-05, 3),
    "Rover3865.dat": Survey(3, 5, None, 0.7, 2.92, 8e-06, 13),
    "Rover4396.dat": Survey(3, 2, None, 0.7, 8.31, 3e-05, 6),
    "Spheres-i099-356-679.hdf5": Survey(3, 356, 12000, 0.7, 24.8, 1e-16, 1068),
    "fc2d_granularflowonwall_00667_00000.dat": Survey(2, 667, None, 0.5, 4.25e-18, 0, 1334),
    "fc2d_granularflowonwall_02020_00213.dat": Survey(2, 2020, None, 0.5, 1.12, 0, None),
    "gfc2d_granularflowonwall_00069_00350.dat": Survey(2, 69, 900, 0.5, 2.26, 1e-16, 136),
}


def published(name: str) -> Path:
    """The file, which must be there where the folder is named."""
    assert FOLDER is not None
    return Path(FOLDER) / name
