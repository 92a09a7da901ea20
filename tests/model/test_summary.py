"""Answers that print: what moves, what presses, whether it is certified, in 80 columns; names are looked up."""

from __future__ import annotations

import html
from dataclasses import replace

import numpy as np
import pytest

import contactqp as cq
from contactqp.model.summary import history_table, wrapped

TRUSS = cq.ContactProblem(
    stiffness=[[59803.0, 6883.1], [6883.1, 77443.0]], load=[60.0, -100.0], normal=[[0.0, -1.0]], gap=[1e-3],
    units={"length": "m", "force": "kN"}, dof_names=["1.x", "1.y"], contact_names=["floor"],
)  # fmt: skip


def floor_of(solution: cq.Solution) -> list[str]:
    """Return the cells that are printed of the truss's contact."""
    return next(line.split() for line in str(solution).splitlines() if line.split()[0] == "floor")


def test_a_certificate_prints_in_80_columns_and_parts_no_number_from_its_name() -> None:
    solution = cq.solve(TRUSS)
    judged = cq.certify(TRUSS, solution.displacement, 1.01 * solution.normal_force)
    for printed in (str(judged), str(cq.solve(TRUSS, "penalty", penalty=1e5).certificate)):
        lines = printed.splitlines()
        assert max(map(len, lines)) <= 80
        assert lines[0] == "REFUSED, error bounds proven"
        assert all(line.startswith("  ") for line in lines[1:])
        assert "tolerance 1e-06)" in printed
        assert not [line for line in lines if line.endswith("tolerance")]


def test_what_is_refused_is_not_called_proven() -> None:
    """ "REFUSED, proven" reads as a proof that the answer is wrong, where its distance to the right one is bounded."""
    rough = TRUSS.replace(tangent=[[1.0, 0.0]], friction=0.3)
    slipping = cq.solve(rough, algorithm="tresca")
    judged = cq.certify(rough, slipping.displacement, 1.01 * slipping.normal_force, slipping.friction_force)
    assert not judged.proven
    assert str(judged).splitlines()[0] == "REFUSED, no error bounds"
    assert repr(judged) == "JudgedAnswer(REFUSED)"


def test_the_method_of_an_answer_with_friction_is_told_in_the_fields_words() -> None:
    lines = str(cq.solve(TRUSS.replace(tangent=[[1.0, 0.0]], friction=0.3), algorithm="tresca")).splitlines()
    assert lines[0].startswith("Tresca fixed-point iteration, each step by active-set: passed;")
    assert max(map(len, lines)) <= 80


def test_a_solution_prints_as_tables() -> None:
    printed = str(cq.solve(TRUSS))
    first, title, header, row, *rest = printed.splitlines()
    assert first.startswith("active-set: passed, proven; energy -0.0986792 kN m; ")
    assert title == "1 contact; 1 closed"
    assert header.split() == ["status", "force", "[kN]", "gap", "[m]"]
    assert row.split() == ["floor", "closed", "30.255", "0"]  # a gap that is the rounding of zero is zero
    assert [line.split() for line in rest[2:]] == [["1.x", "0.00111839"], ["1.y", "-0.001"]]
    assert cq.solve(TRUSS).summary().splitlines()[1:] == [title, header, row, *rest]


def test_friction_and_its_slip_are_printed_with_their_signs() -> None:
    solution = cq.solve(TRUSS.replace(tangent=[[1.0, 0.0]], friction=0.3))
    row = floor_of(solution)
    assert row == ["floor", "slip", "29.2452", "8.77356", "0", "0.000971683"]
    back = cq.solve(TRUSS.replace(tangent=[[-1.0, 0.0]], friction=0.3))
    assert floor_of(back)[3] == "-8.77356"


def test_a_refused_answer_says_so_first_and_no_line_is_wider_than_a_terminal() -> None:
    soft = cq.solve(TRUSS, "penalty", penalty=1e6)
    lines = str(soft).splitlines()
    assert lines[0].startswith("penalty: REFUSED")
    assert any("penetration: floor" in line for line in lines)
    assert max(map(len, lines)) <= 80


def test_of_many_contacts_those_with_the_largest_forces_are_shown() -> None:
    m = 60
    problem = cq.ContactProblem(stiffness=np.eye(m), load=np.arange(m) / 10, normal=np.eye(m), gap=np.full(m, 1.05))
    lines = str(cq.solve(problem)).splitlines()
    assert lines[1] == "60 contacts, the 10 largest; 49 closed"
    assert [line.split()[1] for line in lines[3:13]] == [str(i) for i in range(50, 60)]
    assert len(lines) <= 40


def test_of_contacts_with_friction_all_states_are_counted_and_those_that_slip_are_shown_first() -> None:
    """Twelve pushed down hard that stick, and four pushed less that slip: by force alone none of them was shown."""
    m, slips = 16, 4
    normal, tangent = np.kron(np.eye(m), [[0.0, -1.0]]), np.kron(np.eye(m), [[1.0, 0.0]])
    load = np.tile([0.1, -10.0], m).astype(float)
    load[: 2 * slips] = np.tile([5.0, -1.0], slips)
    problem = cq.ContactProblem(
        stiffness=np.eye(2 * m), load=load, normal=normal, gap=np.zeros(m), tangent=tangent, friction=0.3
    )
    lines = str(cq.solve(problem)).splitlines()
    title = next(k for k, line in enumerate(lines) if line.startswith("16 contacts"))
    assert lines[title] == "16 contacts: 4 slip, 12 stick, 0 open; 10 shown, slip first"
    shown = [line.split()[1:3] for line in lines[title + 2 : title + 12]]
    assert shown[:slips] == [[str(i), "slip"] for i in range(slips)]
    assert {status for _, status in shown[slips:]} == {"stick"}


def test_what_is_rounding_beside_the_forces_that_meet_is_printed_as_zero() -> None:
    """Friction of 2e-15 kN stood beside a normal force of 30 kN, and slips of 1e-19 m beside 1e-3 m."""
    rough = cq.solve(TRUSS.replace(tangent=[[1.0, 0.0]], friction=0.3))
    noisy = replace(rough, answer=replace(rough.answer, friction_force=np.array([[1.96490428095e-15]])))
    assert floor_of(noisy) == ["floor", "slip", "29.2452", "0", "0", "0.000971683"]
    small = replace(rough, answer=replace(rough.answer, friction_force=np.array([[1.96490428095e-8]])))
    assert floor_of(small)[3] == "1.9649e-08"
    held = TRUSS.replace(tangent=[[1.0, 0.0]], friction=0.3, slip_origin=rough.displacement[:1] * (1 + 1e-16))
    stuck = replace(rough, problem=held)
    assert floor_of(stuck)[5] == "0"


def pressed_block(friction: float | None = None) -> cq.ContactProblem:
    """Return a block of 1 by 0.5 whose top is pushed down by 0.02 onto a round punch below its middle."""
    block = cq.Body(cq.rectangle(1.0, 0.5, (8, 4), "quad4"), cq.Material(1.0, 0.3), "plane-strain", name="block")
    structure = cq.Structure([block])
    system = structure.assemble([cq.Support("block", "top", 0), cq.Support("block", "top", 1, -0.02)])
    punch = cq.pair(structure.surface("block", "bottom"), cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 5.0))
    return system.problem([punch], friction=friction, units={"length": "m", "force": "MN"})


def test_contacts_of_bodies_are_printed_with_their_places_and_the_largest_force_with_its_own() -> None:
    for friction in (None, 0.3):
        solution = cq.solve(pressed_block(friction))
        lines = str(solution).splitlines()
        assert "  largest force: contact 4 at (0.5, 0) m" in lines
        assert "largest force: contact 4 at (0.5, 0) m" in solution._repr_html_()
        assert max(map(len, lines)) <= 80
    lines = str(cq.solve(pressed_block())).splitlines()
    assert any(line.endswith("at [m]") for line in lines)
    assert any(line.split()[:2] == ["contact", "4"] and line.endswith("(0.5, 0)") for line in lines)
    long = [f"a name of a contact that takes half of a line, {i}" for i in range(9)]
    named = str(cq.solve(pressed_block(0.3).replace(contact_names=long)))
    assert f"largest force: {long[4]} at (0.5, 0) m" in named
    assert "at [m]" not in named
    assert "largest force:" not in str(cq.solve(TRUSS))


def test_a_small_force_far_from_large_ones_is_printed() -> None:
    """What meets at a contact's own unknowns decides, not the largest force of the problem."""
    apart = cq.ContactProblem(stiffness=np.eye(2), load=[1e9, 2e-9], normal=np.eye(2), gap=[0.0, 1e-9])
    assert str(cq.solve(apart)).splitlines()[4].split()[3] == "1e-09"


def test_a_local_problem_prints_its_forces_and_velocities() -> None:
    slides = cq.LocalProblem(delassus=np.eye(3), offset=[-2.0, 5.0, 0.0], friction=0.5, dimension=3)
    lines = str(cq.solve(slides)).splitlines()
    assert ": passed; " in lines[0]
    assert lines[-2].split() == ["status", "r_N", "r_T1", "r_T2", "u_N", "u_T1", "u_T2"]
    assert lines[-1].split() == ["contact", "0", "slip", "2", "-1", "0", "0", "4", "0"]


def test_notebooks_get_html_in_which_names_are_escaped() -> None:
    shown = cq.solve(TRUSS.replace(contact_names=["a<b"]))._repr_html_()
    assert "<td>a&lt;b</td><td>closed</td><td>30.255</td>" in shown


@pytest.mark.slow
def test_notebooks_show_what_print_does_of_histories_certificates_and_comparisons() -> None:
    solution = cq.solve(TRUSS)
    judged = cq.certify(TRUSS, solution.displacement, 1.01 * solution.normal_force)
    compared = cq.compare(TRUSS, methods=["active-set", "lemke"])
    local = cq.solve(cq.LocalProblem(delassus=np.eye(2), offset=[-2.0, 5.0], friction=0.5, dimension=2))
    for shown in (cq.follow_path(TRUSS, [TRUSS.load]), solution.certificate, judged, compared, local):
        assert shown._repr_html_() == f"<pre>{html.escape(str(shown))}</pre>"
    assert [compared[0].method, *(row.method for row in compared[1:])] == ["active-set", "lemke"]


def test_the_noise_of_forces_is_zero_in_the_table_of_a_history() -> None:
    history = cq.follow_path(TRUSS, [TRUSS.load], events="exact")
    forces = np.array([0.0, 7e-17, 30.0])[:, None]
    noisy = [replace(history[0], answer=replace(history[0].answer, normal_force=force)) for force in forces]
    lines = history_table(np.arange(3.0), noisy, forces, ()).splitlines()
    assert [line.split()[2:] for line in lines[2:]] == [["0", "0.001"], ["0", "0.001"], ["30", "floor", "0.001"]]


def test_numbers_are_had_by_name() -> None:
    solution = cq.solve(TRUSS)
    with pytest.raises(cq.InvalidProblem, match="'floor' is a contact: force_at, gap_at, friction_at and status_at"):
        solution.at("floor")
    named_alike = cq.solve(TRUSS.replace(dof_names=["1.x", "floor"]))
    assert named_alike.at("floor") == named_alike.displacement[1]
    assert solution.at("1.x") == solution.at(0) == solution.displacement[0]
    assert solution.force_at("floor") == solution.force_at(0) == solution.normal_force[0]
    assert solution.gap_at("floor") == solution.gap[0] == solution.gap_at(-1)
    assert (solution.status_at("floor"), solution.friction_at("floor")) == ("closed", None)
    with pytest.raises(cq.InvalidProblem, match=r"no unknown is called '1.z'; nearest: 1\.[xy], 1\.[xy]"):
        solution.at("1.z")
    with pytest.raises(cq.InvalidProblem, match="no contact is called 'flor'; nearest: floor"):
        solution.force_at("flor")
    with pytest.raises(cq.InvalidProblem, match="no contact is called 'flor'; nearest: floor"):
        solution.status_at("flor")
    with pytest.raises(cq.InvalidProblem, match="no contact is called 1"):
        solution.force_at(1)
    rough = cq.solve(TRUSS.replace(tangent=[[1.0, 0.0]], friction=0.3))
    assert rough.status_at("floor") == "slip"
    assert rough.friction_at("floor") == pytest.approx(0.3 * rough.force_at("floor"))


def test_a_history_prints_its_instants_and_events() -> None:
    history = cq.follow_path(TRUSS, [TRUSS.load], events="exact")
    lines = str(history).splitlines()
    assert lines[0] == f"{len(history)} instants; 1 event"
    assert lines[1] == "  time [legs]  closed  largest force [kN]     at  smallest gap [m]"
    assert lines[-2].split() == ["1", "1", "30.255", "floor", "0"]
    assert lines[-1].startswith("  floor closed at 0.7")


def sled(feet: int = 21) -> cq.History:
    """Feet on springs, pressed down and then pushed: those that carry least slip first."""
    normal, tangent = np.kron(np.eye(feet), [[0.0, -1.0]]), np.kron(np.eye(feet), [[1.0, 0.0]])
    pressed = np.ravel([[0.0, -(1.0 + i)] for i in range(feet)])
    pushed = pressed + np.tile([3.0, 0.0], feet)
    problem = cq.ContactProblem(
        stiffness=np.eye(2 * feet), load=np.zeros(2 * feet), normal=normal, gap=np.full(feet, 0.5), tangent=tangent,
        friction=0.3, units={"length": "mm", "force": "N"},
    )  # fmt: skip
    return cq.follow_path(problem, [pressed, pushed], steps=4)


@pytest.mark.slow
def test_a_history_of_one_solution_prints_as_the_solution() -> None:
    history = cq.run("bar_wall")
    assert str(history) == str(history[0])
    assert "legs" not in str(history)


@pytest.mark.slow
def test_a_history_with_friction_prints_its_states_its_friction_and_its_events_together() -> None:
    lines = str(sled()).splitlines()
    assert lines[0] == "9 instants; 31 events"
    assert lines[1].split() == [
        "time", "[legs]", "slip", "stick", "open", "max", "force", "[N]", "at", "max", "friction", "[N]"
    ]  # fmt: skip
    assert lines[-1].endswith("slip at 2")
    last = next(line.split() for line in reversed(lines) if line.split()[0] == "2")
    assert last[1:4] == ["10", "11", "0"]
    assert "  contact 2 and 18 others closed at 0.25" in lines
    assert max(map(len, lines)) <= 80
    assert len(lines) <= 40


@pytest.mark.slow
def test_of_many_instants_that_of_the_largest_force_is_shown_and_the_others_are_not_passed_off_as_all() -> None:
    """Pressed hardest at the 20th of 30 steps, which no even choice of twelve has."""
    peak = [*np.linspace(0.0, 1.0, 21)[1:], *np.linspace(1.0, 0.5, 11)[1:]]
    history = cq.follow_path(TRUSS, [size * TRUSS.load for size in peak], steps=1)
    lines = str(history).splitlines()
    shown = [line.split() for line in lines[2:] if line.strip()[0].isdigit()]
    assert lines[0].startswith(f"{len(history)} instants, {len(shown)} shown, that of the largest force among them; ")
    assert "  each event is listed at the first instant that shows it" in lines
    assert max(map(len, lines)) <= 80
    largest = np.max(history.normal_forces)
    assert f"{largest:.6g}" in {row[2] for row in shown}
    few = cq.follow_path(TRUSS, [TRUSS.load], steps=11)
    assert len(few) == 12
    assert str(few).count("\n") >= 12


@pytest.mark.parametrize(
    ("units", "words"),
    [
        ({"length": "kN", "force": "m"}, "expected a length, got 'kN'"),
        ({"length": "m", "force": "mm"}, "expected a force, got 'mm'"),
        ({"length": "m", "force": "kg"}, "expected a force, got 'kg'"),
        ({"length": "mm", "force": "MPa"}, "expected a force, got 'MPa'"),
        ({"length": "rad", "force": "N"}, "expected a length, got 'rad'"),
        ({"length": "m"}, "both of them"),
        ("mm,N", 'both of them, as in ."length": "mm", "force": "N"., got \'mm,N\''),
    ],
)
def test_units_that_are_none_or_half_given_are_refused(units, words: str) -> None:
    with pytest.raises(cq.InvalidProblem, match=words):
        TRUSS.replace(units=units)


def test_one_contact_may_be_a_row_and_a_number() -> None:
    plain = cq.ContactProblem(
        stiffness=np.eye(2), load=[0.0, 2.0], normal=[0.0, 1.0], gap=0.5, tie=[1.0, 0.0], tie_value=0.1
    )
    assert plain.normal.shape == (1, 2)
    solution = cq.solve(plain)
    assert (solution.normal_force[0], solution.at(0)) == (1.5, 0.1)
    with pytest.raises(cq.InvalidProblem, match="gap: expected shape"):
        cq.ContactProblem(stiffness=np.eye(2), load=[0.0, 2.0], normal=np.eye(2), gap=0.5)


@pytest.mark.parametrize("sparse", [False, True])
def test_what_is_no_number_is_named_by_row_and_column(sparse: bool) -> None:
    import scipy.sparse as sp

    K = np.diag([1.0, 2.0, 3.0])
    K[1, 2] = np.nan
    with pytest.raises(cq.InvalidProblem, match=r"stiffness: expected finite numbers, got nan at \[1, 2\]"):
        cq.ContactProblem(stiffness=sp.csc_array(K) if sparse else K, load=np.ones(3), normal=np.eye(3), gap=np.ones(3))


@pytest.mark.parametrize(
    ("option", "meant"),
    [
        ("tol", "tolerance"),
        ("tolerence", "tolerance"),
        ("eps_abs", "tolerance"),
        ("maxiter", "max_iter"),
        ("polsh", "polish"),
    ],
)
def test_an_unknown_keyword_names_the_one_that_may_be_meant(option: str, meant: str) -> None:
    with pytest.raises(cq.InvalidProblem, match=f"unknown option '{option}' .do you mean '{meant}'"):
        cq.solve(TRUSS, **{option: 1})


@pytest.mark.parametrize("name", ["Active-Set", "ACTIVE_SET", "active_set"])
def test_methods_are_found_whatever_their_case(name: str) -> None:
    assert cq.solve(TRUSS, name).method == "active-set"


def test_a_method_takes_the_same_way_whatever_its_case() -> None:
    """The default was compared by its name: in other letters a local problem went to the convex methods."""
    slides = cq.LocalProblem(delassus=np.diag([2.0, 1.0, 1.0]), offset=[-2.0, 5.0, 0.0], friction=0.5, dimension=3)
    assert cq.solve(slides, "Active-Set").method == cq.solve(slides).method == "newton"
    rough = TRUSS.replace(tangent=[[1.0, 0.0]], friction=0.3)
    assert cq.solve(rough, "ACTIVE_SET").method == cq.solve(rough).method


def test_what_is_shown_in_a_line_has_no_arrays() -> None:
    mesh, material = cq.rectangle(1.0, 0.5, (20, 10), "quad4"), cq.Material(modulus=1.0, poisson=0.3)
    structure = cq.Structure([cq.Body(mesh, material, "plane-strain", name="block")])
    system = structure.assemble([cq.Support("block", "top", 0), cq.Support("block", "top", 1, -0.02)])
    surface = structure.surface("block", "bottom")
    pairing = cq.pair(surface, cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 5.0))
    problem = system.problem([pairing], friction=0.3)
    solution = cq.solve(problem)
    ball = cq.ContactProblem(stiffness=[[0.0]], load=[0.0], normal=[[1.0]], gap=[1.0])
    motion = cq.impact(ball, [2.0], [0.0], [4.0], duration=1.0, time_step=0.1)
    klarbring = cq.ContactProblem(
        stiffness=[[5.0, -2.0], [-2.0, 1.0]], load=[-1.0, 0.65], normal=[[-1.0, 0.0]], gap=[0.0],
        tangent=[[0.0, 1.0]], friction=0.8,
    )  # fmt: skip
    judged = cq.certify(problem, solution.displacement, solution.normal_force, solution.friction_force)
    local = cq.solve(cq.LocalProblem(delassus=np.eye(2), offset=[-2.0, 5.0], friction=0.5, dimension=2))
    shown = {
        repr(pairing): "Pairing(21 contacts on 462 unknowns, gaps from 0 to 0.025)",
        repr(system): "System(462 unknowns, 420 of them free, of block)",
        repr(surface): "Surface(block.bottom, 20 facets)",
        repr(solution): f"Solution({solution.method}, 420 unknowns, 21 contacts, passed)",
        repr(motion): "MotionHistory(11 solutions, times 0 to 1)",
        repr(motion[-1]): "Moving(moreau-jean with active-set, 1 unknown, 1 contact, passed, proven)",
        repr(motion.motion): "Motion(moreau-jean, 11 states a time step of 0.1 apart, "
        "ContactProblem(1 unknown, 1 contact, 0 ties))",
        repr(judged): "JudgedAnswer(passed, proven)",
        repr(local): f"LocalSolution({local.method}, 1 contact, passed)",
        repr(cq.exact_equilibria(klarbring)[-1]): "ExactEquilibrium(2 unknowns, contacts: slip)",
        repr(cq.exact(TRUSS)): "ExactSolution(rational, 2 unknowns, 1 contact)",
    }
    assert list(shown) == list(shown.values())
    critical = repr(cq.critical_friction(problem))
    assert critical.startswith(
        "CriticalFriction(least 1.65906 at contact 20, contraction 0.180825, kappa 0.970311, one "
    )
    assert "\n" not in critical + repr(cq.compare(TRUSS, "active-set"))


def test_no_line_ends_between_a_number_and_its_unit() -> None:
    units = {"length": "mm", "force": "N"}
    problem = cq.ContactProblem([[2.0]], [3.0], [[1.0]], [1.0], units=units, contact_names=["left"])
    long = replace(cq.solve(problem), method="Tresca fixed-point iteration, each step by active-set")
    first, second, *_ = str(long).splitlines()
    assert len(first) <= 80
    assert second.startswith("  energy -2 N mm; ")
    assert wrapped("word " * 14 + "123.456 mm (0.5 of the lengths)")[1].strip().startswith("123.456 mm")


def test_a_proven_force_beside_a_stiff_spring_is_not_printed_as_zero() -> None:
    """Two nodes on a spring of 1e14 are pressed on a stop with 0.5; the terms of K u are of 1e14."""
    k = 1e14
    stop = cq.ContactProblem([[k + 1, -k], [-k, k]], [0, 1.5], [[0, 1.0]], [1.0])
    solution = cq.solve(stop)
    assert solution.certificate.proven
    assert "closed    0.5" in str(solution)
