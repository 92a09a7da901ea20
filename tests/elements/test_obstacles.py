"""Rigid obstacles: distances that are exact, normals that are their gradients, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.obstacle import tangent_frames, tangents
from contactqp.errors import InvalidProblem

ORIGIN = [0.0, 0.0, 0.0]
OBSTACLES = {
    "plane": cq.Plane(point=[0.1, 0.2, 0.3], normal=[1.0, -2.0, 2.0]),
    "circle": cq.Circle([0.5, -0.5], 2.0),
    "hole": cq.Circle([0.5, -0.5], 2.0, inside=True),
    "sphere": cq.Sphere([0.5, -0.5, 1.0], 2.0),
    "cavity": cq.Sphere([0.5, -0.5, 1.0], 2.0, inside=True),
    "cylinder": cq.Cylinder([1.0, 0.0, 0.0], [1.0, 1.0, 2.0], 0.7),
    "bore": cq.Cylinder([1.0, 0.0, 0.0], [1.0, 1.0, 2.0], 0.7, inside=True),
    "paraboloid": cq.Paraboloid([0.1, 0.2, 0.3], [1.0, 0.5, -1.0], 3.0, measure="normal"),
    "bowl": cq.Paraboloid([0.1, 0.2], [1.0, 0.5], 30.0, inside=True, measure="normal"),
    "function": cq.SignedDistance(lambda x: np.hypot(x[:, 0], x[:, 1]) - 1.5, dimension=3),
}


def some_points(dimension: int) -> np.ndarray:
    return np.random.default_rng(4).uniform(1, 3, (20, dimension))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", OBSTACLES)
def test_normals_are_the_gradients_of_the_distance(name):
    obstacle = OBSTACLES[name]
    x, h = some_points(obstacle.dimension), 1e-5
    n = obstacle.normals(x)
    slopes = [
        (obstacle.distance(x + h * e) - obstacle.distance(x - h * e)) / (2 * h) for e in np.eye(obstacle.dimension)
    ]
    np.testing.assert_allclose(n, np.array(slopes).T, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, atol=1e-14)
    assert np.abs(n).max() > 0.1


def in_units(obstacle, unit):
    """The obstacle with all lengths in another unit; directions may have any length."""
    if isinstance(obstacle, cq.SignedDistance):
        return cq.SignedDistance(lambda x: unit * obstacle.function(x / unit), obstacle.dimension)
    lengths = {"point", "centre", "apex", "radius", "axis", "normal"}
    named = {name: np.asarray(value) * unit for name, value in vars(obstacle).items() if name in lengths}
    return replace(obstacle, **named)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("power", [-900, -600, -480, 480, 600, 900])
@pytest.mark.parametrize("name", OBSTACLES)
def test_units_change_no_distance_and_no_normal(name, power):
    obstacle, unit = OBSTACLES[name], 2.0**power
    other, x = in_units(obstacle, unit), some_points(obstacle.dimension)
    np.testing.assert_allclose(other.distance(x * unit) / unit, obstacle.distance(x), rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(other.normals(x * unit), obstacle.normals(x), rtol=0, atol=1e-9)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", OBSTACLES)
def test_no_points_have_no_distances(name):
    obstacle = OBSTACLES[name]
    none = np.zeros((0, obstacle.dimension))
    assert obstacle.distance(none).shape == (0,)
    assert obstacle.normals(none).shape == (0, obstacle.dimension)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", OBSTACLES)
def test_a_step_along_the_normal_is_a_step_of_the_distance(name):
    """True of a distance only: of x^2 + y^2 - R^2 or of a gap along an axis it is not."""
    obstacle = OBSTACLES[name]
    x = some_points(obstacle.dimension)
    far = x + 0.01 * obstacle.normals(x)
    np.testing.assert_allclose(obstacle.distance(far) - obstacle.distance(x), 0.01, rtol=0, atol=1e-11)


def test_distances_are_exact_on_a_3_4_5_triangle():
    point = [[3.0, 4.0]]
    assert cq.Circle([0.0, 0.0], 2.0).distance(point).tolist() == [3.0]
    assert cq.Circle([0.0, 0.0], 6.0, inside=True).distance(point).tolist() == [1.0]
    assert cq.Circle([0.0, 0.0], 6.0).distance(point).tolist() == [-1.0]
    np.testing.assert_allclose(cq.Circle([0.0, 0.0], 6.0, inside=True).normals(point), [[-0.6, -0.8]], atol=1e-16)
    assert cq.Sphere(ORIGIN, 6.0).distance([[2.0, 3.0, 6.0]]).tolist() == [1.0]
    assert cq.Cylinder([0.0, 0.0, 9.0], [0.0, 0.0, -7.0], 2.0).distance([[3.0, 4.0, 55.0]]).tolist() == [3.0]


def test_the_paraboloid_measures_hertz_gap_along_its_axis():
    """An indenter of R = 4 whose apex is 0.5 over the half-space: gap = 0.5 + r^2 / (2 R), pressed straight down."""
    indenter = cq.Paraboloid(apex=[1.0, 0.0, 0.5], axis=[0.0, 0.0, -2.0], radius=4.0)
    x = np.array([[1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [1.0, 4.0, 0.1]])
    assert np.allclose(indenter.distance(x), [0.5, 1.0, 2.4], atol=1e-15)
    assert indenter.normals(x).tolist() == [[0.0, 0.0, -1.0]] * 3
    bowl = cq.Paraboloid(apex=[0.0, 0.0], axis=[0.0, 1.0], radius=4.0, inside=True)
    assert bowl.distance([[2.0, 1.5]]).tolist() == [1.0]


@pytest.mark.slow
@pytest.mark.parametrize("inside", [False, True])
def test_the_normal_distance_of_the_paraboloid_is_the_least_of_a_fine_sample(inside):
    obstacle = cq.Paraboloid([0.0, 0.0], [0.0, 1.0], 2.0, inside=inside, measure="normal")
    x = np.random.default_rng(1).uniform(-1.5, 1.5, (50, 2))
    r = np.linspace(-4, 4, 200001)
    surface = np.stack([r, (1 if inside else -1) * r**2 / 4], axis=1)
    least = np.array([np.linalg.norm(surface - point, axis=1).min() for point in x])
    np.testing.assert_allclose(np.abs(obstacle.distance(x)), least, atol=1e-7)  # the sample's step is 4e-5
    along_axis = cq.Paraboloid([0.0, 0.0], [0.0, 1.0], 2.0, inside=inside).distance(x)
    assert (np.sign(obstacle.distance(x)) == np.sign(along_axis)).all()
    assert (np.abs(along_axis) >= least - 1e-7).all()


def test_the_apex_and_the_axis_are_no_exception():
    obstacle = cq.Paraboloid(ORIGIN, [0.0, 0.0, 1.0], 2.0, measure="normal")
    assert obstacle.distance([ORIGIN, [0.0, 0.0, 3.0], [0.0, 0.0, -1.0]]).tolist() == [0.0, 3.0, -1.0]


def test_a_signed_distance_is_the_sphere_it_describes():
    x = some_points(3)
    sphere = cq.Sphere(ORIGIN, 1.0)
    by_differences = cq.SignedDistance(lambda x: np.linalg.norm(x, axis=1) - 1, dimension=3)
    np.testing.assert_allclose(by_differences.distance(x), sphere.distance(x), atol=1e-15)
    np.testing.assert_allclose(by_differences.normals(x), sphere.normals(x), atol=1e-9)
    by_gradient = cq.SignedDistance(by_differences.function, dimension=3, gradient=sphere.normals)
    np.testing.assert_allclose(by_gradient.normals(x), sphere.normals(x), atol=1e-15)


@pytest.mark.parametrize(
    ("obstacle", "points", "message"),
    [
        (cq.SignedDistance(lambda x: (x**2).sum(axis=1) - 1, 2), [[0.6, 0.8]], "length 2; expected 1 within 1e-06"),
        (cq.SignedDistance(lambda x: np.abs(x[:, 0]), 2), [[0.0, 1.0]], r"point 0, \[0.0, 1.0\].*kink"),
        (cq.SignedDistance(lambda x: x[:, 0], 1), [[0.0]], "expected `step`"),
        (cq.SignedDistance(lambda x: x, 2), [[0.0, 1.0]], r"expected shape \(1,\), got \(1, 2\)"),
        (cq.SignedDistance(lambda x: np.log(x[:, 0]) * np.nan, 2), [[1.0, 1.0]], "expected a finite value, got nan"),
        (
            cq.SignedDistance(lambda x: x[:, 0], 2, gradient=lambda x: 2 * x),
            [[0.3, 0.4], [3.0, 4.0]],
            r"point 1, \[3.0, 4.0\], the gradient has the length 10",
        ),
        (cq.Circle([1.0, 2.0], 1.0), [[1.0, 2.0]], r"circle: point 0, \[1.0, 2.0\], lies at the centre"),
        (cq.Sphere([1.0, 2.0, 3.0], 1.0), [ORIGIN, [1.0, 2.0, 3.0]], "sphere: point 1"),
        (cq.Cylinder(ORIGIN, [0.0, 0.0, 1.0], 1.0), [[0.0, 0.0, 4.0]], "cylinder: point 0"),
        (cq.Paraboloid([0.0, 0.0], [0.0, 1.0], 2.0, measure="normal"), [[0.0, -3.0]], "beyond the radius 2"),
    ],
)
def test_points_without_a_normal_are_refused(obstacle, points, message):
    with pytest.raises(InvalidProblem, match=message):
        cq.pair(points, obstacle)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: cq.Circle([0.0, 0.0, 0.0], 1.0), "circle centre: expected 2 finite components"),
        (lambda: cq.Sphere([0.0, 0.0], 1.0), "sphere centre: expected 3"),
        (lambda: cq.Sphere(ORIGIN, -1.0), "sphere radius: expected a positive length, got -1"),
        (lambda: cq.Circle([0.0, 0.0], 0.0), "circle radius: expected a positive length, got 0"),
        (lambda: cq.Circle([0.0, 0.0], "one"), "Circle: radius: expected a number, got 'one'"),
        (lambda: cq.Circle(["a", "b"], 1.0), "circle centre: expected real numbers"),
        (lambda: cq.Cylinder(ORIGIN, ORIGIN, None), "Cylinder: radius: expected a number, got None"),
        (lambda: cq.Paraboloid([0.0, 0.0], [0.0, 1.0], "one"), "Paraboloid: radius: expected a number"),
        (lambda: cq.Plane([0.0, np.nan], [0.0, 1.0]), "plane point: expected finite components"),
        (lambda: cq.Plane([0.0, 0.0], [0.0, np.inf]), "plane normal: expected finite components"),
        (lambda: cq.Cylinder(ORIGIN, ORIGIN, 1.0), "cylinder axis: expected a vector of positive length"),
        (lambda: cq.Cylinder(ORIGIN, [0.0, 0.0, np.inf], 1.0), "cylinder axis: expected 3 finite"),
        (lambda: cq.Paraboloid(ORIGIN, [0.0, 1.0], 1.0), "paraboloid: expected an apex and an axis"),
        (lambda: cq.Paraboloid(ORIGIN, [0.0, 1.0, np.nan], 1.0), "paraboloid: expected finite"),
        (lambda: cq.Paraboloid(ORIGIN, [0.0, 1.0, 0.0], 0.0), "paraboloid radius"),
        (lambda: cq.Paraboloid(ORIGIN, [0.0, 1.0, 0.0], 1.0, measure="up"), "Paraboloid: measure: expected one of"),
        (lambda: cq.SignedDistance(lambda x: x, 4), "dimension 1, 2 or 3"),
        (lambda: cq.SignedDistance(lambda x: x, 2, step=0.0), "positive step"),
    ],
)
def test_obstacles_that_are_none_are_refused(make, message):
    with pytest.raises(InvalidProblem, match=message):
        make()


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_many_frames_are_the_single_ones(dimension):
    normals = np.random.default_rng(0).normal(size=(30, dimension))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    frames = tangent_frames(normals)
    for n, frame in zip(normals, frames, strict=True):
        np.testing.assert_allclose(frame, tangents(n), atol=1e-15)
    whole = np.concatenate([normals[:, np.newaxis], frames], axis=1)
    np.testing.assert_allclose(whole @ whole.transpose(0, 2, 1), np.tile(np.eye(dimension), (30, 1, 1)), atol=1e-14)


def test_pairs_with_a_sphere_are_its_linearised_gap():
    sphere = cq.Sphere([0.0, 0.0, -10.0], 10.0)
    x = np.random.default_rng(2).uniform(-1, 1, (5, 3))
    u = 1e-6 * np.random.default_rng(3).uniform(-1, 1, (5, 3))
    E_N, g, E_T = cq.pair(x, sphere)
    np.testing.assert_allclose(sphere.distance(x + u), g - E_N @ u.ravel(), atol=1e-12)
    rows = np.concatenate([E_N.toarray()[:, np.newaxis], E_T.toarray().reshape(5, 2, 15)], axis=1)
    np.testing.assert_allclose(rows @ rows.transpose(0, 2, 1), np.tile(np.eye(3), (5, 1, 1)), atol=1e-14)
