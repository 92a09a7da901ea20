"""An elastica pushed against a wall far beyond buckling: the exact rod by its differential equation, ours a chain of
links whose internal force is formed from lengths that nearly cancel."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag
from scipy.optimize import root

import contactqp as cq
from contactqp.solving import runs

SIDE_LOAD, SHORTENED = 0.05, 0.3


class Elastica:
    """`links` stretchable links with bending springs between them, clamped along x; EI = L = 1.

    W = EA / (2 h) sum (l_i - h)^2 + EI / (2 h) sum (angle_i - angle_i-1)^2, half the length at the clamp.
    """

    def __init__(self, links: int, axial: float) -> None:
        self.h, self.axial = 1 / links, axial
        self.points = np.column_stack([np.linspace(0, 1, links + 1), np.zeros(links + 1)])
        self.dimension = self.points.size
        self.spring = np.full(links, 1 / self.h)
        self.spring[0] *= 2
        self.difference = sp.kron(sp.diags([-1.0, 1.0], [0, 1], shape=(links, links + 1)), sp.identity(2)).tocsr()
        self.turn = sp.diags([1.0, -1.0], [0, -1], shape=(links, links)).tocsr()

    def _links(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        link = np.diff(self.points + u.reshape(-1, 2), axis=0)
        length = np.hypot(*link.T)
        angle = np.unwrap(np.arctan2(link[:, 1], link[:, 0]))
        return link, length, self.turn @ angle

    def energy(self, u: np.ndarray) -> float:
        _, length, turned = self._links(u)
        return float(self.axial / (2 * self.h) * np.sum((length - self.h) ** 2) + 0.5 * self.spring @ turned**2)

    def _pull(self, length: np.ndarray) -> np.ndarray:
        return self.axial / self.h * (length - self.h)

    def internal_force(self, u: np.ndarray) -> np.ndarray:
        link, length, turned = self._links(u)
        across = np.column_stack([-link[:, 1], link[:, 0]]) / length[:, None] ** 2
        moment = self.turn.T @ (self.spring * turned)
        force = (self._pull(length) / length)[:, None] * link + moment[:, None] * across
        return np.asarray(self.difference.T @ force.ravel())

    def tangent(self, u: np.ndarray) -> sp.csc_array:
        link, length, turned = self._links(u)
        along = link / length[:, None]
        across = np.column_stack([-along[:, 1], along[:, 0]])
        moment = self.turn.T @ (self.spring * turned)
        shear = (along[:, :, None] * across[:, None, :] + across[:, :, None] * along[:, None, :]) / length[
            :, None, None
        ] ** 2
        blocks = self.axial / self.h * along[:, :, None] * along[:, None, :]
        blocks = blocks + (self._pull(length) / length)[:, None, None] * across[:, :, None] * across[:, None, :]
        blocks = blocks - moment[:, None, None] * shear
        angles = sp.csr_array(block_diag(*(row[None] / size for row, size in zip(across, length, strict=True))))
        angles = angles.T @ (self.turn.T @ sp.diags(self.spring) @ self.turn) @ angles
        return sp.csc_array(self.difference.T @ (sp.csr_array(block_diag(*blocks)) + angles) @ self.difference)


def pushed(links: int, axial: float, steps: int, moves: bool = True, **options: int) -> cq.LargeHistory:
    """The tip takes its side load; then the clamp moves towards the wall that the tip touches."""
    rod = Elastica(links, axial)
    n = rod.dimension
    wall = cq.ObstacleContact([rod.points[-1]], cq.Plane([1.0, 0.0], [-1.0, 0.0]), [[n - 2, n - 1]], dimension=n)
    load = np.append(np.zeros(n - 1), SIDE_LOAD)
    corners = [[0.0, 0.0], [SHORTENED, 0.0]][: 1 + moves]
    return cq.large_deformation(
        rod, [load] * len(corners), wall, steps=steps, tie=np.eye(2, n), tie_values=corners, **options
    )


def exact_rod() -> tuple[float, float]:
    """P and the height of the tip: t'' + P sin t + Q cos t = 0, t(0) = t'(1) = 0, the integral of cos t being 0.7."""

    def rod(unknown: np.ndarray) -> np.ndarray:
        force = unknown[1]

        def along(_: float, y: np.ndarray) -> list[float]:
            bent = -force * np.sin(y[0]) - SIDE_LOAD * np.cos(y[0])
            return [y[1], bent, np.cos(y[0]), np.sin(y[0])]

        return solve_ivp(along, (0, 1), [0, unknown[0], 0, 0], rtol=1e-11, atol=1e-12).y[:, -1]

    found = root(lambda unknown: [rod(unknown)[1], rod(unknown)[2] - 1 + SHORTENED], [2.0, 2.9])
    assert found.success
    return float(found.x[1]), float(rod(found.x)[3])


def test_the_tangent_is_that_of_the_force_and_the_force_that_of_the_energy() -> None:
    rod, rng = Elastica(6, 100.0), np.random.default_rng(1)
    u, v = 0.03 * rng.normal(size=(2, rod.dimension))
    e = 1e-6
    assert (rod.energy(u + e * v) - rod.energy(u - e * v)) / (2 * e) == pytest.approx(rod.internal_force(u) @ v)
    slope = (rod.internal_force(u + e * v) - rod.internal_force(u - e * v)) / (2 * e)
    np.testing.assert_allclose(rod.tangent(u) @ v, slope, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_a_rod_is_pushed_far_beyond_buckling() -> None:
    force, height = exact_rod()
    assert (force, height) == pytest.approx((2.872949, 0.628932), abs=1e-6)
    errors = []
    for links in (6, 12):
        last = pushed(links, 1e5, steps=4)[-1]
        assert last.load_factor == 2
        assert last.certificate.passed
        assert last.displacement[-1] == pytest.approx(height, rel=5e-3)
        errors.append(abs(last.normal_force[0] - force))
    assert errors[1] < 3e-3 * force
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.3)  # of second order


@pytest.mark.slow
@pytest.mark.parametrize("links", [5, 12])  # their lengths are rounded, and so are the forces at rest
def test_rounding_of_a_bodys_own_force_is_no_lack_of_balance_and_is_said(links: int) -> None:
    history = pushed(links, 1e6, steps=2, moves=False)
    said = [note for solution in history for note in solution.certificate.notes if "is rounding" in note]
    assert said
    bent = history[-1].displacement[-1]
    # A cantilever of links with half a link's spring at the clamp: Q h sum (1 - (i - 1) h)^2, at the clamp of half h.
    arms = 1 - np.arange(links) / links
    arms[0] /= np.sqrt(2)
    assert bent == pytest.approx(SIDE_LOAD / links * np.sum(arms**2), rel=1e-3)


@pytest.mark.slow
def test_a_step_that_does_not_converge_is_halved() -> None:
    """Eight iterations are too few for the whole way at once; all steps that were taken stand in the history."""
    history = pushed(8, 1e3, steps=1, max_iter=8)
    assert [t for t in history.times if t in (1.0, 2.0)] == [1.0, 2.0]
    assert len(history) > 3
    assert np.all(np.diff(history.times) > 0)
    whole = pushed(8, 1e3, steps=8)
    assert history[-1].normal_force == pytest.approx(whole[-1].normal_force, rel=1e-9)


@pytest.mark.slow
def test_steps_of_newtons_method_are_refined_and_the_converged_one_is_certified(monkeypatch) -> None:
    """Each of some ten a load step: a certificate of its linearised problem says nothing of the rod."""
    certified = []
    certify = runs.certificate_of
    monkeypatch.setattr(runs, "certificate_of", lambda *given: certified.append(given) or certify(*given))
    history = pushed(6, 1e3, steps=2)
    assert sum(len(solution.iterations) for solution in history) > len(history)
    assert all(solution.certificate.passed for solution in history)
    assert not certified  # by `solve`: those of the history are made of the converged steps


@pytest.mark.slow
def test_a_step_whose_refined_signs_fail_is_solved_and_certified(monkeypatch) -> None:
    whole = pushed(6, 1e3, steps=2)
    monkeypatch.setattr(runs.CondensedRun, "_polished", lambda _: None)
    again = pushed(6, 1e3, steps=2)
    assert again[-1].certificate.passed
    assert again[-1].normal_force == pytest.approx(whole[-1].normal_force, rel=1e-9)


class Spring:
    """One unknown on a spring, whose force or tangent is wrong."""

    dimension = 1

    def __init__(self, jump: float = 0.0, tangent: float = 1.0) -> None:
        self.jump, self.slope = jump, tangent

    def energy(self, u: np.ndarray) -> float:
        return float(0.5 * u @ u + self.jump * abs(u[0] - 0.5))

    def internal_force(self, u: np.ndarray) -> np.ndarray:
        return u + self.jump * np.where(u >= 0.5, 1.0, -1.0)

    def tangent(self, u: np.ndarray) -> sp.csc_array:  # noqa: ARG002
        return sp.csc_array([[self.slope]])


@pytest.mark.slow
@pytest.mark.parametrize("body", [Spring(jump=1e-3), Spring(jump=1e-5), Spring(tangent=0.3)])
def test_a_force_that_jumps_or_does_not_belong_to_its_tangent_is_no_rounding(body: Spring) -> None:
    assert cq.large_deformation(Spring(), [[0.5]], steps=1)[-1].displacement == pytest.approx([0.5])
    with pytest.raises(cq.NotConverged):
        cq.large_deformation(body, [[0.5]], steps=1, max_iter=8)


class RoundedBar(Spring):
    """A bar of length 1 whose strain is formed as (1 + u) - 1, in steps of 2e-16."""

    def energy(self, u: np.ndarray) -> float:
        return float(self.slope / 2 * ((1.0 + u[0]) - 1.0) ** 2)

    def internal_force(self, u: np.ndarray) -> np.ndarray:
        return self.slope * ((1.0 + u) - 1.0)

    def tangent(self, u: np.ndarray) -> sp.csc_array:  # noqa: ARG002
        return sp.csc_array([[self.slope]])


@pytest.mark.parametrize(("stiffness", "load"), [(1e6, 1.7), (1e6, 1e-2), (31554.57413051647, 0.13370360718792781)])
@pytest.mark.parametrize("wall", [False, True])
def test_a_strain_that_is_rounded_is_balanced_as_far_as_it_can_be(stiffness: float, load: float, wall: bool) -> None:
    """The energy is rounded as the strain is: that it does not fall along a step says no more than the force does."""
    free = load / stiffness
    contact = cq.ObstacleContact([[0.0]], cq.Plane([free / 2], [-1.0])) if wall else None
    last = cq.large_deformation(RoundedBar(tangent=stiffness), [[load]], contact, steps=5)[-1]
    assert last.certificate.passed
    rounding = 4 * 2.2e-16
    np.testing.assert_allclose(last.displacement, free / 2 if wall else free, rtol=0, atol=rounding)
    if wall:
        np.testing.assert_allclose(last.normal_force, load / 2, rtol=0, atol=rounding * stiffness)


@pytest.mark.slow
def test_a_tip_that_lands_and_sticks_does_so_where_it_lands_whatever_the_steps() -> None:
    """Its cantilever is bent onto a floor. Where the tip lands no force acts, so that friction keeps it without any:
    force and place are those without friction, in one step as in many.
    """
    rod = Elastica(8, 1e4)
    n = rod.dimension
    floor = cq.ObstacleContact([rod.points[-1]], cq.Plane([0.0, -0.7], [0.0, 1.0]), [[n - 2, n - 1]], dimension=n)
    load = np.append(np.zeros(n - 1), -20.0)
    held = dict(tie=np.eye(2, n), tie_values=[[0.0, 0.0]])
    smooth = cq.large_deformation(rod, [load], floor, steps=1, **held)[-1]
    for steps in (1, 3):
        rough = cq.large_deformation(rod, [load], floor, steps=steps, friction=0.3, **held)[-1]
        assert rough.contact_status.tolist() == ["stick"]
        assert rough.normal_force == pytest.approx(smooth.normal_force, rel=1e-7)
        assert abs(rough.friction_force[0, 0]) < 1e-6 * rough.normal_force[0]
        assert rough.displacement[-2] == pytest.approx(smooth.displacement[-2], rel=1e-8)
