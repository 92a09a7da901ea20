"""Convergence to closed forms at the order that theory gives: degree + 1 in the displacement."""

import numpy as np
import pytest
import scipy.sparse.linalg as spla

from contactqp.elements.loads import Pressure, Traction
from contactqp.elements.material import Material
from contactqp.elements.reference_elements import REFERENCES
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body, stress_at_nodes
from contactqp.elements.structure import Structure, Support
from tests.elements.bodies import PLANE, SOLID

E, NU = 1000.0, 0.3
MATERIAL = Material(modulus=E, poisson=NU)


def order(sizes, errors):
    """The slope of log(error) over log(element size) on the finer two meshes."""
    return np.polyfit(np.log(sizes[-2:]), np.log(errors[-2:]), 1)[0]


def error(found, exact):
    """Root of the mean square over the nodes, relative to the largest value."""
    return np.sqrt(np.mean((np.asarray(found) - exact) ** 2)) / np.abs(exact).max()


def degree(kind):
    return 1 if len(REFERENCES[kind].nodes) == REFERENCES[kind].corners else 2


def solved(body, supports, loads):
    system = Structure([body]).assemble(supports, loads)
    return system.expand(spla.spsolve(system.K, system.f))


LENGTH, HEIGHT, SHEAR = 4.0, 1.0, 2.0
INERTIA = HEIGHT**3 / 12


def cantilever(x):
    """Timoshenko & Goodier 1970, art. 21: u, sigma_xx, sigma_xy of a plane-stress beam held at (LENGTH, 0).

    Their sigma_xx = -P x y / I with P = -SHEAR; the slope of the axis at the wall is 0; y from -HEIGHT/2 to HEIGHT/2.
    """
    P, G, c = -SHEAR, E / (2 * (1 + NU)), HEIGHT / 2
    X, Y = x[:, 0], x[:, 1]
    u = -P * X**2 * Y / (2 * E * INERTIA) - NU * P * Y**3 / (6 * E * INERTIA) + P * Y**3 / (6 * INERTIA * G)
    u += (P * LENGTH**2 / (2 * E * INERTIA) - P * c**2 / (2 * INERTIA * G)) * Y
    v = NU * P * X * Y**2 / (2 * E * INERTIA) + P * X**3 / (6 * E * INERTIA)
    v += -P * LENGTH**2 * X / (2 * E * INERTIA) + P * LENGTH**3 / (3 * E * INERTIA)
    sxx, sxy = -P * X * Y / INERTIA, -P * (c**2 - Y**2) / (2 * INERTIA)
    return np.column_stack([u, v]), sxx, sxy


def cantilever_error(kind, cells, wrong=1.0):
    mesh = rectangle(LENGTH, HEIGHT, (4 * cells, cells), kind, corner=(0.0, -HEIGHT / 2))
    body = Body(mesh, MATERIAL, "plane-stress", name="beam")
    exact = cantilever(mesh.points)[0]
    supports = []
    for point, axes in (((LENGTH, 0.5), (0, 1)), ((LENGTH, -0.5), (0,))):
        i = mesh.nearest(point)
        supports += [Support("beam", i, axis, float(exact[i, axis])) for axis in axes]

    def traction(sign):
        def t(x):
            _, sxx, sxy = cantilever(x)
            return wrong * sign * np.column_stack([sxx, sxy])

        return t

    loads = [Traction("beam", "left", traction(-1.0)), Traction("beam", "right", traction(1.0))]
    u = solved(body, supports, loads).reshape(-1, 2)
    return error(u, exact)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", PLANE)
def test_the_cantilever_converges_to_timoshenkos(kind):
    cells = [4, 8, 16] if degree(kind) == 1 else [2, 4, 8]
    errors = [cantilever_error(kind, n) for n in cells]
    assert errors[-1] < (0.02 if degree(kind) == 1 else 2e-5)
    assert order(1 / np.array(cells), errors) > degree(kind) + 0.75


def test_the_cantilever_with_a_load_of_one_percent_more_is_one_percent_off():
    assert 100 * cantilever_error("quad8", 4) < cantilever_error("quad8", 4, wrong=1.01) < 0.01


INNER, OUTER, INSIDE, OUTSIDE = 1.0, 2.0, 3.0, 0.5


def lame(r, model):
    """Lame 1852: a thick cylinder under pressure inside and outside, held along its axis (plane strain) or free."""
    a2, b2 = INNER**2, OUTER**2
    A = (INSIDE * a2 - OUTSIDE * b2) / (b2 - a2)
    B = (INSIDE - OUTSIDE) * a2 * b2 / (b2 - a2)
    if model == "plane-stress":
        radial = ((1 - NU) * A * r + (1 + NU) * B / r) / E
    else:
        radial = (1 + NU) / E * ((1 - 2 * NU) * A * r + B / r)
    return radial, A - B / r**2, A + B / r**2


def ring(kind, model, cells):
    """Radial displacement and stresses at the nodes, and their closed form."""
    pressures = [Pressure("ring", "left", INSIDE), Pressure("ring", "right", OUTSIDE)]
    if model == "axisymmetric":
        mesh = rectangle(OUTER - INNER, 0.5, (2 * cells, cells), kind, corner=(INNER, 0.0))
        supports = [Support("ring", "bottom", 1), Support("ring", "top", 1)]
    else:  # a quarter
        flat = rectangle(OUTER - INNER, np.pi / 2, (2 * cells, 3 * cells), kind, corner=(INNER, 0.0))
        mesh = flat.mapped(lambda x: x[:, :1] * np.column_stack([np.cos(x[:, 1]), np.sin(x[:, 1])]))
        supports = [Support("ring", "bottom", 1), Support("ring", "top", 0)]
    body = Body(mesh, MATERIAL, model, name="ring")
    u = solved(body, supports, pressures)
    r = mesh.points[:, 0] if model == "axisymmetric" else np.linalg.norm(mesh.points, axis=1)
    direction = np.array([1.0, 0.0]) if model == "axisymmetric" else mesh.points / r[:, None]
    return (u.reshape(-1, 2) * direction).sum(axis=1), stress_at_nodes(body, u), lame(r, model)


@pytest.mark.sampled(15)
@pytest.mark.parametrize("model", ["plane-strain", "plane-stress", "axisymmetric"])
@pytest.mark.parametrize("kind", PLANE)
def test_the_thick_cylinder_converges_to_lames(kind, model):
    cells = [4, 8, 16] if degree(kind) == 1 else [2, 4, 8]
    errors, stress_errors = [], []
    for n in cells:
        radial, stress, (exact, s_radial, s_hoop) = ring(kind, model, n)
        errors.append(error(radial, exact))
        trace, across = s_radial + s_hoop, 1 if model == "axisymmetric" else 2
        stress_errors.append(error(stress[:, 0] + stress[:, 3 - across], trace))
        expected = 0 * trace if model == "plane-stress" else NU * trace
        assert np.abs(stress[:, across] - expected).max() < 0.5 / n * INSIDE
    assert order(1 / np.array(cells), errors) > degree(kind) + 0.75
    assert order(1 / np.array(cells), stress_errors) > degree(kind) - 0.2
    assert errors[-1] < (2e-3 if degree(kind) == 1 else 1e-5)


def sphere_error(kind, cells):
    """A sector of a thick sphere; the exact displacement on its radial sides, pressure inside and outside."""
    flat = box((OUTER - INNER, 1.0, 1.0), (2 * cells, cells, cells), kind, corner=(INNER, -0.5, -0.5))

    def curved(x):
        direction = np.column_stack([np.ones(len(x)), np.tan(x[:, 1]), np.tan(x[:, 2])])
        return x[:, :1] * direction / np.linalg.norm(direction, axis=1, keepdims=True)

    mesh = flat.mapped(curved)
    body = Body(mesh, MATERIAL, "3d", name="shell")
    a3, b3 = INNER**3, OUTER**3
    A = (INSIDE * a3 - OUTSIDE * b3) / (b3 - a3)
    B = (INSIDE - OUTSIDE) * a3 * b3 / (2 * (b3 - a3))
    r = np.linalg.norm(mesh.points, axis=1, keepdims=True)
    exact = mesh.points / r * ((1 - 2 * NU) * A * r + (1 + NU) * B / r**2) / E
    held = np.zeros(mesh.points.shape, dtype=bool)
    for side in ("front", "back", "bottom", "top"):
        held[mesh.nodes(side)] = True
    held, K = held.ravel(), body.stiffness
    f = Pressure("shell", "left", INSIDE).forces(body) + Pressure("shell", "right", OUTSIDE).forces(body)
    u = np.where(held, exact.ravel(), 0.0)
    u[~held] = spla.spsolve(K[~held][:, ~held], (f - K @ u)[~held])
    return error(u, exact.ravel())


@pytest.mark.slow
@pytest.mark.parametrize("kind", SOLID)
def test_the_thick_sphere_converges_to_lames(kind):
    """Timoshenko & Goodier 1970, art. 136."""
    cells = [4, 8] if degree(kind) == 1 else [2, 4]
    errors = [sphere_error(kind, n) for n in cells]
    assert order(1 / np.array(cells), errors) > degree(kind) + 0.65
    assert errors[-1] < (2e-3 if degree(kind) == 1 else 3e-4)


def test_linear_elements_lock_near_incompressibility_and_quadratic_ones_hardly():
    """The note of Material: a thick cylinder at nu = 0.4999 in plane strain, on the same mesh."""
    rubber = Material(modulus=E, poisson=0.4999)
    found = {}
    for kind in ("quad4", "quad8"):
        flat = rectangle(OUTER - INNER, np.pi / 2, (6, 9), kind, corner=(INNER, 0.0))
        mesh = flat.mapped(lambda x: x[:, :1] * np.column_stack([np.cos(x[:, 1]), np.sin(x[:, 1])]))
        body = Body(mesh, rubber, "plane-strain", name="ring")
        supports = [Support("ring", "bottom", 1), Support("ring", "top", 0)]
        u = solved(body, supports, [Pressure("ring", "left", 1.0)])
        found[kind] = u.reshape(-1, 2)[mesh.nearest((INNER, 0.0)), 0]
    a2, b2 = INNER**2, OUTER**2
    nu = rubber.poisson
    exact = (1 + nu) / E * a2 / (b2 - a2) * ((1 - 2 * nu) * INNER + b2 / INNER)
    assert found["quad4"] < 0.7 * exact
    assert abs(found["quad8"] / exact - 1) < 0.02
