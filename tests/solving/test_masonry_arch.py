"""The least thickness of a masonry arch: rigid voussoirs, joints that neither pull nor slide (a linear program)."""

import numpy as np
import pytest

import contactqp as cq


def arch(thickness: float, voussoirs: int = 10, radius: float = 1.0, weight: float = 1.0) -> cq.ContactProblem:
    """A semicircle under its weight, thickness / radius of the middle line; contacts at both ends of every joint."""
    joints = np.linspace(0, np.pi, voussoirs + 1)
    inside, outside = radius * (1 - thickness / 2), radius * (1 + thickness / 2)
    half = np.pi / voussoirs / 2
    middle = 2 / 3 * np.sin(half) / half * (outside**3 - inside**3) / (outside**2 - inside**2)
    centre = middle * np.column_stack([np.cos(joints[:-1] + half), np.sin(joints[:-1] + half)])
    load = np.zeros(3 * voussoirs)
    load[1::3] = -weight / voussoirs
    normal, tie = [], []
    for k, angle in enumerate(joints):
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        for end in (inside, outside):
            rows = np.zeros((2, 3 * voussoirs))
            for body, sign in ((k - 1, 1.0), (k, -1.0)):
                if 0 <= body < voussoirs:
                    arm = end * along - centre[body]
                    for row, n in zip(rows, (across, along), strict=True):
                        row[3 * body : 3 * body + 3] = sign * np.array([*n, arm[0] * n[1] - arm[1] * n[0]])
            normal.append(rows[0])
        tie.append(rows[1])
    ties = dict(tie=tie, tie_value=np.zeros(len(tie)))
    return cq.ContactProblem(np.zeros((3 * voussoirs, 3 * voussoirs)), load, normal, np.zeros(len(normal)), **ties)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("radius", "weight"), [(1.0, 1.0), (5000.0, 2e5)])
def test_the_least_thickness_of_a_semicircular_arch_is_milankovitchs(radius: float, weight: float) -> None:
    """0.1075 of the radius (M. Milankovitch 1907; J. Ochsendorf 2006); with ten voussoirs 0.10746."""
    thick = cq.solve(arch(0.1076, radius=radius, weight=weight))
    assert thick.certificate.passed
    springings = thick.normal_force[:2].sum(), thick.normal_force[-2:].sum()
    assert sum(springings) == pytest.approx(weight, rel=1e-9)
    assert springings[0] == pytest.approx(weight / 2, rel=1e-4)  # lines of thrust that are not symmetric fit in, too
    with pytest.raises(cq.NoEquilibrium):
        cq.solve(arch(0.1073, radius=radius, weight=weight))


def test_displacements_by_rounding_open_no_joint_of_an_arch_at_rest() -> None:
    """Forces of the arch are shared; at a vertex, as beside contacts opened by 1e-45, they would seem to be unique."""
    thick = arch(0.3)
    for k, step in enumerate(cq.follow_path(thick, [thick.load], steps=4)):
        assert step.certificate.proven
        assert step.normal_force[[0, 1, -2, -1]].sum() == pytest.approx(0.25 * k, rel=1e-9)  # the weight
    solved = cq.solve(thick)
    for moved in (0.0, 1e-60, 1e-45):
        found = cq.certify(thick, np.full(30, moved), solved.normal_force, tie_force=solved.tie_force)
        assert found.passed, moved
    pulled = solved.normal_force - 0.01
    assert not cq.certify(thick, np.zeros(30), pulled, tie_force=solved.tie_force).passed
