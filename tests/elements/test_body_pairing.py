"""Body against body: who meets whom, gaps, balance of forces and moments, and what is refused."""

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements import mortar_segments
from contactqp.errors import InvalidProblem

PAIRINGS = [cq.pair_node_to_segment, cq.pair_mortar]


def sheet(n, height, facing, first, kind="quad4", spread=(0.0, 1.0), shift=0.0):
    """A surface over the square spread x spread at z = height(x, y); `facing` is +1 for normals that point upwards."""
    s = np.linspace(*spread, n + 1)
    x, y = np.meshgrid(s, s + shift, indexing="ij")
    points = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    k = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    facets = np.stack([k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]], axis=-1).reshape(-1, 4)
    facets = facets if facing > 0 else facets[:, ::-1]
    if kind == "tri3":
        facets = np.concatenate([facets[:, :3], facets[:, [0, 2, 3]]])
    return cq.Surface(points, facets, first + np.arange(points.size).reshape(points.shape), f"sheet {first}")


def chain(points, first, name="chain"):
    points = np.array(points, dtype=float)
    k = np.arange(len(points) - 1)
    unknowns = first + np.arange(points.size).reshape(points.shape)
    return cq.Surface(points, np.stack([k, k + 1], axis=1), unknowns, name)


def two_curved(kind="quad4"):
    upper = sheet(5, lambda x, y: 0.1 + 0.2 * (x**2 + x * y), -1, 0, kind, (0.1, 0.9))
    lower = sheet(4, lambda x, y: 0.1 * np.sin(2 * x + y) - 0.2, +1, 1000, kind)
    return upper, lower


def two_arcs():
    angle = np.linspace(0.4, -0.4, 10)  # walking left: the body is above
    ball = chain(np.stack([-np.sin(angle), 1.01 - np.cos(angle)], axis=1), 0, "ball")
    x = np.linspace(0.7, -0.7, 8)
    return ball, chain(np.stack([x, 0.1 * x**2 - 0.02], axis=1), 1000, "ground")


SCENES = {"arcs": two_arcs, "quads": two_curved, "triangles": lambda: two_curved("tri3")}


@pytest.mark.slow
@pytest.mark.parametrize("pairing_of", PAIRINGS)
def test_surfaces_that_are_far_apart_are_searched_in_little_memory(pairing_of):
    """Balls along a normal of 1e13 times a facet filled all memory."""

    def level(height):
        return lambda x, y: height + 0 * (x + y)

    master = sheet(4, level(0.0), +1, 1000)
    for height in (3.0, 1e13):
        upper = sheet(5, level(height), -1, 0, spread=(0.1, 0.9))
        assert pairing_of(upper, master).gap == pytest.approx(np.full(36, height), rel=1e-12)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("pairing_of", PAIRINGS)
@pytest.mark.parametrize("scene", SCENES)
def test_a_common_translation_closes_no_gap(pairing_of, scene):
    slave, master = SCENES[scene]()
    pairing = pairing_of(slave, master)
    d = slave.dimension
    assert len(pairing.gap) > 5
    for e in np.eye(d):
        together = np.zeros(pairing.normal.shape[1])
        together[slave.unknowns], together[master.unknowns] = e, e
        np.testing.assert_allclose(pairing.normal @ together, 0, atol=1e-13)
        np.testing.assert_allclose(pairing.tangent @ together, 0, atol=1e-13)
    only_slave = np.zeros(pairing.normal.shape[1])
    only_slave[slave.unknowns[:, -1]] = 1.0
    assert (pairing.normal @ only_slave < -0.5).all()  # lifting the upper body opens every gap


@pytest.mark.sampled(3)
@pytest.mark.parametrize("pairing_of", PAIRINGS)
@pytest.mark.parametrize("scene", SCENES)
def test_forces_and_moments_balance_with_a_gap_and_on_curved_surfaces(pairing_of, scene):
    """The forces on both bodies, -E_N' lambda, have no resultant and no moment."""
    slave, master = SCENES[scene]()
    pairing = pairing_of(slave, master)
    assert pairing.gap.min() > 1e-3
    force = -pairing.normal.T @ np.random.default_rng(0).uniform(0, 1, len(pairing.gap))
    bodies = [(body.points, force[body.unknowns]) for body in (slave, master)]
    size = np.abs(force).sum()
    assert np.abs(sum(f.sum(axis=0) for _, f in bodies)).max() < 1e-14 * size
    moment = sum(np.cross(_in_space(x), _in_space(f)).sum(axis=0) for x, f in bodies)
    assert np.abs(moment).max() < 1e-13 * size
    assert np.abs(np.cross(*map(_in_space, bodies[0])).sum(axis=0)).max() > 1e-3 * size  # one body alone has one


def _in_space(x):
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1])))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("pairing_of", PAIRINGS)
@pytest.mark.parametrize("scene", SCENES)
def test_rows_of_a_contact_are_orthonormal(pairing_of, scene):
    """E_N e and E_T e of the slave's translation are the coordinates of e in one frame, shorter where facets bend."""
    slave, master = SCENES[scene]()
    pairing = pairing_of(slave, master)
    d, n = slave.dimension, pairing.normal.shape[1]
    frames = np.zeros((len(pairing.gap), d, d))
    for a in range(d):
        u = np.zeros(n)
        u[slave.unknowns[:, a]] = 1.0
        frames[:, 0, a] = -(pairing.normal @ u)
        frames[:, 1:, a] = (pairing.tangent @ u).reshape(-1, d - 1)
    product = frames @ frames.transpose(0, 2, 1)
    bend = 1e-13 if pairing_of is cq.pair_node_to_segment else 0.05
    np.testing.assert_allclose(product, np.tile(np.eye(d), (len(frames), 1, 1)), atol=bend)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("pairing_of", PAIRINGS)
@pytest.mark.parametrize("kind", ["quad4", "tri3"])
def test_the_gap_between_parallel_sheets_is_their_distance(pairing_of, kind):
    upper = sheet(3, lambda x, _: 0.5 + 0.25 * x, -1, 0, kind, (0.2, 0.7))
    lower = sheet(4, lambda x, _: 0.25 * x, +1, 100, kind)
    pairing = pairing_of(upper, lower)
    np.testing.assert_allclose(pairing.gap, 0.5 / np.hypot(1, 0.25), rtol=1e-13)
    np.testing.assert_allclose(pairing.direction, np.tile([-0.25, 0, 1] / np.hypot(1, 0.25), (16, 1)), atol=1e-14)
    assert pairing.nodes.tolist() == list(range(16))
    np.testing.assert_allclose(pairing.area.sum(), 0.25 * np.hypot(1, 0.25), rtol=1e-13)
    turned = pairing_of(upper, lower, dimension=500)
    assert turned.normal.shape == (16, 500)
    assert turned.tangent.shape == (32, 500)


@pytest.mark.parametrize("pairing_of", PAIRINGS)
def test_a_linear_gap_is_averaged_or_sampled_exactly(pairing_of):
    """gap = 0.1 + x on flat facets: at the nodes by segments, int N_i gap / int N_i by mortar."""
    upper = chain([[0.0, 0.3], [0.5, 0.3], [1.0, 0.3]], 0)
    lower = chain([[1.5, -1.3], [0.7, -0.5], [-0.5, 0.7]], 10)
    flat_gap = 0.3 + np.array([0.0, 0.5, 1.0]) - 0.2
    if pairing_of is cq.pair_node_to_segment:
        np.testing.assert_allclose(pairing_of(upper, lower).gap, flat_gap / np.sqrt(2), rtol=1e-13)
    else:  # along the slave's normal; weights 2/3 and 1/3 at the ends
        ends = flat_gap + np.array([0.5 / 3, 0, -0.5 / 3])
        np.testing.assert_allclose(pairing_of(upper, lower).gap, ends, rtol=1e-13)


def test_node_to_segment_takes_the_nearest_foot_and_its_shape_functions():
    slave = chain([[-0.2, 0.1], [0.25, 0.1], [1.5, 0.2]], 0)
    master = chain([[2.0, 0.0], [1.0, 0.0], [0.0, 0.0]], 6)
    pairing = cq.pair_node_to_segment(slave, master)
    assert pairing.nodes.tolist() == [1, 2]
    assert pairing.unpaired.tolist() == [0]  # stands over the end
    np.testing.assert_allclose(pairing.gap, [0.1, 0.2], rtol=1e-13)
    np.testing.assert_allclose(pairing.normal.toarray()[0, [3, 9, 11]], [-1, 0.25, 0.75], rtol=1e-13)
    np.testing.assert_allclose(pairing.normal.toarray()[1, [5, 7, 9]], [-1, 0.5, 0.5], rtol=1e-13)
    np.testing.assert_allclose(pairing.tangent.toarray()[0, [2, 8, 10]], [1, -0.25, -0.75], rtol=1e-13)
    np.testing.assert_allclose(pairing.area, tributary([0.45, np.hypot(1.25, 0.1)]), rtol=1e-13)
    assert cq.pair_node_to_segment(slave, master, reach=0.15).nodes.tolist() == [1]


def tributary(lengths):
    return [sum(lengths) / 2, lengths[1] / 2]


def test_over_a_ridge_the_normal_is_the_direction_from_it():
    """A roof with its ridge at (0, 0): the node above it is nearest to the ridge itself."""
    roof = chain([[1.0, -1.0], [0.0, 0.0], [-1.0, -1.0]], 6)
    slave = chain([[-0.1, 0.5], [0.0, 0.5], [0.2, 0.4]], 0)
    pairing = cq.pair_node_to_segment(slave, roof)
    np.testing.assert_allclose(pairing.direction, [[-0.1, 0.5], [0, 0.5], [0.2, 0.4]] / pairing.gap[:, np.newaxis])
    np.testing.assert_allclose(pairing.gap, np.hypot([-0.1, 0, 0.2], [0.5, 0.5, 0.4]), rtol=1e-14)
    touching = cq.pair_node_to_segment(chain([[-0.1, 0.5], [0.0, 0.0], [0.1, 0.5]], 0), roof)
    np.testing.assert_allclose(touching.direction[1], [0, 1], atol=1e-14)
    assert touching.gap[1] == 0


def test_an_overlapping_node_in_a_valley_keeps_its_sign():
    valley = chain([[1.0, 1.0], [0.0, 0.0], [-1.0, 1.0]], 6)
    pairing = cq.pair_node_to_segment(chain([[-0.5, 2.0], [0.0, -0.01], [0.5, 2.0]], 0), valley)
    assert pairing.nodes.tolist() == [1]
    np.testing.assert_allclose(pairing.gap, [-0.01], rtol=1e-13)
    np.testing.assert_allclose(pairing.direction, [[0, 1]], atol=1e-14)


def test_a_quadratic_master_is_met_where_it_is_curved():
    """A parabola y = -x^2 / 2 as one line3: the node at (0, 0.3) is 0.3 over its top."""
    master = cq.Surface(
        np.array([[1.0, -0.5], [-1.0, -0.5], [0.0, 0.0]]), np.array([[0, 1, 2]]), np.arange(6, 12).reshape(3, 2), "arch"
    )
    slave = chain([[0.0, 0.3], [0.5, 0.3], [0.6, 0.4]], 0)
    pairing = cq.pair_node_to_segment(slave, master)
    assert np.isclose(pairing.gap[0], 0.3, rtol=1e-13)
    parabola = cq.Paraboloid([0.0, 0.0], [0.0, 1.0], 1.0, measure="normal")
    np.testing.assert_allclose(pairing.gap, parabola.distance(slave.points), rtol=1e-12)
    np.testing.assert_allclose(pairing.direction, parabola.normals(slave.points), atol=1e-12)


def test_far_and_graded_masters_are_searched_to_the_nearest():
    """One facet of size 10 beside thousands of size 1e-3: nothing is lost to the search."""
    x = np.concatenate([np.linspace(0, 1, 1001), [11.0]])[::-1]
    master = chain(np.stack([x, 0 * x], axis=1), 100)
    slave = chain([[0.5, 3.0], [5.0, 0.5], [10.9, 4.0]], 0)
    np.testing.assert_allclose(cq.pair_node_to_segment(slave, master).gap, [3.0, 0.5, 4.0], rtol=1e-12)


def test_walls_at_right_angles_and_backs_have_no_partner():
    """All four sides of a square over a wide ground: its bottom meets the ground and its top does not."""
    corners = [[0.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0], [0.0, 1.0]]
    square = cq.Surface(
        np.array(corners[:4]), np.array([[0, 1], [1, 2], [2, 3], [3, 0]]), np.arange(8).reshape(4, 2), "square"
    )
    ground = chain([[3.0, 0.0], [-2.0, 0.0]], 8)
    nodes = cq.pair_node_to_segment(square, ground)
    assert nodes.nodes.tolist() == [0, 1]
    assert nodes.unpaired.tolist() == [2, 3]
    mortar = cq.pair_mortar(square, ground)
    assert mortar.nodes.tolist() == [0, 1]
    np.testing.assert_allclose(mortar.direction, [[0, 1], [0, 1]], atol=1e-15)
    np.testing.assert_allclose(mortar.area, 0.5, rtol=1e-14)


@pytest.mark.parametrize("pairing_of", PAIRINGS)
def test_overlap_beyond_the_stated_is_refused_with_its_depth(pairing_of):
    lower = sheet(2, lambda x, _: 0 * x, +1, 100)
    upper = sheet(3, lambda x, y: np.where((x < 0.1) & (y < 0.1), -0.04, 0 * x), -1, 0)
    where = "node 0 is 0.04" if pairing_of is cq.pair_node_to_segment else "facet 0 .* is 0.0"
    with pytest.raises(InvalidProblem, match=f"sheet 0: {where}.* inside sheet 100 .*at most 0.001"):
        pairing_of(upper, lower, overlap=1e-3)
    with pytest.raises(InvalidProblem, match="inside"):
        pairing_of(sheet(3, lambda x, _: 0 * x - 0.2, -1, 0), lower)
    assert pairing_of(upper, lower, overlap=0.041).gap.min() < 0


@pytest.mark.sampled(2)
@pytest.mark.parametrize("pairing_of", PAIRINGS)
def test_bodies_that_do_not_face_each_other_are_refused(pairing_of):
    upper, lower = sheet(2, lambda x, _: 0 * x + 1, -1, 0), sheet(3, lambda x, _: 0 * x, +1, 100)
    with pytest.raises(InvalidProblem, match=r"sheet 0 and sheet 100 .*face each other"):
        pairing_of(upper, sheet(3, lambda x, _: 0 * x, -1, 100))
    with pytest.raises(InvalidProblem, match="sheet 0: node 0 belongs to sheet 0 as well"):
        pairing_of(upper, upper)
    with pytest.raises(InvalidProblem, match=r"3 dimensions and .* has 2"):
        pairing_of(upper, chain([[1.0, 0.0], [0.0, 0.0]], 300))
    with pytest.raises(InvalidProblem, match="expected numbers from 0 to 109, got 147"):
        pairing_of(upper, lower, dimension=110)
    for wrong in (-1.0, 0.0, np.nan):
        with pytest.raises(InvalidProblem, match="reach: expected a positive length, got"):
            pairing_of(upper, lower, reach=wrong)
    with pytest.raises(InvalidProblem, match="overlap: expected a length"):
        pairing_of(upper, lower, overlap=-0.1)
    assert len(pairing_of(upper, lower, reach=0.5).gap) == 0
    assert pairing_of(upper, lower, reach=0.5).unpaired.tolist() == list(range(9))


def test_the_mortar_refuses_quadratic_facets_and_facets_behind_each_other():
    arch = cq.Surface(
        np.array([[1.0, -0.5], [-1.0, -0.5], [0.0, 0.0]]), np.array([[0, 1, 2]]), np.arange(6).reshape(3, 2), "arch"
    )
    with pytest.raises(InvalidProblem, match=r"arch: expected linear facets .* got line3"):
        cq.pair_mortar(chain([[-1.0, 1.0], [1.0, 1.0]], 6), arch)
    near, far = sheet(2, lambda x, _: 0 * x, +1, 100), sheet(3, lambda x, _: 0 * x - 0.3, +1, 200)
    both = cq.Surface(
        np.concatenate([near.points, far.points]),
        np.concatenate([near.facets, far.facets + len(near.points)]),
        np.concatenate([near.unknowns, far.unknowns]),
        "shelves",
    )
    upper = sheet(2, lambda x, _: 0 * x + 0.2, -1, 0)
    with pytest.raises(InvalidProblem, match=r"facet 0 sees the facets 0 and 4 of shelves one behind the other"):
        cq.pair_mortar(upper, both)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("mine", "theirs"), [("quad4", "quad4"), ("tri3", "quad4"), ("quad4", "tri3"), ("tri3", "tri3")]
)
def test_the_areas_of_a_mortar_are_the_covered_area(mine, theirs):
    upper = sheet(5, lambda x, _: 0 * x, -1, 0, mine, (-0.3, 1.1), shift=0.37)
    lower = sheet(7, lambda x, _: 0 * x, +1, 1000, theirs)
    pairing = cq.pair_mortar(upper, lower)
    np.testing.assert_allclose(pairing.area.sum(), 1.0 * (1.0 - 0.07), rtol=1e-13)
    assert set(pairing.unpaired) == set(upper.nodes) - set(pairing.nodes)
    assert pairing.unpaired.size


def test_clipping_squares_and_triangles():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    turned = np.array([[0.5, -0.2], [1.2, 0.5], [0.5, 1.2], [-0.2, 0.5]])
    common = mortar_segments.clip(turned[np.newaxis], square[np.newaxis])
    assert np.isclose(mortar_segments.areas(common)[0], 1 - 4 * 0.3**2 / 2, rtol=1e-14)  # an octagon
    corner = np.array([[2.0, 2.0], [0.0, 2.0], [2.0, 0.5]])
    assert np.isclose(
        mortar_segments.areas(mortar_segments.clip(corner[np.newaxis], square[np.newaxis]))[0], 0.0, atol=1e-15
    )
    moved = square + np.array([0.25, 0.5])
    assert np.isclose(
        mortar_segments.areas(mortar_segments.clip(moved[np.newaxis], square[np.newaxis]))[0], 0.375, rtol=1e-15
    )
    assert mortar_segments.areas(mortar_segments.clip(square[np.newaxis] + 5, square[np.newaxis]))[0] == 0
    several = mortar_segments.clip(np.stack([turned, moved, square + 5, square]), np.stack([square] * 4))
    np.testing.assert_allclose(mortar_segments.areas(several), [0.82, 0.375, 0, 1], atol=1e-14)
    fans = mortar_segments.areas(mortar_segments.triangles(several).reshape(-1, 3, 2)).reshape(4, -1)
    np.testing.assert_allclose(fans.sum(axis=1), mortar_segments.areas(several), atol=1e-15)


def test_clipping_random_triangles_is_symmetric_and_additive():
    """area(A in B) = area(B in A), and the two halves of a cut square take all of A in the square."""
    rng = np.random.default_rng(5)
    a, b = _triangles(rng, 200), _triangles(rng, 200)
    np.testing.assert_allclose(
        mortar_segments.areas(mortar_segments.clip(a, b)),
        mortar_segments.areas(mortar_segments.clip(b, a)),
        rtol=0,
        atol=1e-14,
    )
    left = np.array([[0.0, 0.0], [0.6, 0.0], [0.3, 1.0], [0.0, 1.0]])
    right = np.array([[0.6, 0.0], [1.0, 0.0], [1.0, 1.0], [0.3, 1.0]])
    halves = [mortar_segments.areas(mortar_segments.clip(a, np.tile(half, (200, 1, 1)))) for half in (left, right)]
    np.testing.assert_allclose(sum(halves), mortar_segments.areas(a), atol=1e-14)
    assert min(half.max() for half in halves) > 0.1


def _triangles(rng, count):
    t = rng.uniform(0, 1, (count, 3, 2))
    clockwise = mortar_segments.areas(t) < 0
    t[clockwise] = t[clockwise][:, ::-1]
    return t


@pytest.fixture
def two_blocks():
    """A block of its own mesh on a foundation."""
    material = cq.Material(modulus=1.0, poisson=0.3)
    block = cq.Body(cq.rectangle(1.0, 0.5, (3, 2), "quad4"), material, "plane-strain", name="block")
    base = cq.Body(cq.rectangle(1.0, 0.5, (4, 2), "quad4", corner=(0.0, -0.5)), material, "plane-strain", name="base")
    return cq.Structure([block, base])


@pytest.mark.parametrize("pairing_of", PAIRINGS)
def test_surfaces_of_bodies_that_each_count_from_zero_are_refused(two_blocks, pairing_of):
    block, base = two_blocks.bodies
    assert len(pairing_of(two_blocks.surface("block", "bottom"), two_blocks.surface("base", "top")).gap) > 2
    with pytest.raises(InvalidProblem, match=r"each body counts its own from 0; structure\.surface"):
        pairing_of(block.surface("bottom"), base.surface("top"))


def test_two_bodies_are_no_body_and_an_obstacle(two_blocks):
    with pytest.raises(InvalidProblem, match=r"two bodies are paired by pair_mortar\(slave, master\)"):
        cq.pair(two_blocks.surface("block", "bottom"), two_blocks.surface("base", "top"))


def test_one_pairing_needs_no_list(two_blocks):
    supports = [
        cq.Support(body, side, axis) for body, side in (("block", "top"), ("base", "bottom")) for axis in (0, 1)
    ]
    system = two_blocks.assemble(supports)
    pairing = cq.pair_mortar(two_blocks.surface("block", "bottom"), two_blocks.surface("base", "top"))
    one, listed = system.problem(pairing), system.problem([pairing])
    assert one.contacts == listed.contacts > 2
    np.testing.assert_array_equal(one.normal.toarray(), listed.normal.toarray())
