"""Gallery problems from the course chapter, in units that make its data doubles.

The chapter is R. Perera and A. Carnicero, Contact Mechanics in 1D Elastostatics Problems (chapter 2 of Contact
Non-linearities, Master's Degree in Numerical Simulation in Engineering with ANSYS, twelfth edition, 2020).

Its examples are printed in kN and m. With kN and mm, stiffnesses are in kN/mm; with mN and mm in mN/mm, the same
numbers as in N/m.
"""

from __future__ import annotations

from fractions import Fraction

from contactqp.oracle.gallery.problem import Contents, stated

CHAPTER = "Perera and Carnicero (2020), contact mechanics in 1D elastostatics problems"
# EA = 315 MN, 2 m and 1 m long.
BAR, SHORT_BAR = Fraction("157.5"), Fraction(315)  # kN/mm
TRUSS = ((59803000, 6883100), (6883100, 77443000))  # N/m, as printed
TRUSS_LOAD = (60_000_000, -100_000_000)  # mN


def _bar(load: Fraction, displacement: Fraction, force: Fraction, description: str, formula: str) -> Contents:
    return stated(
        stiffness=[[BAR]],
        load=[load],
        normal=[[1]],
        gap=[1],
        displacement=[displacement],
        normal_force=[force],
        description=description,
        source=f"{CHAPTER}, Example 2.5",
        formula=formula,
        units=("mm", "kN"),
        unknowns=["tip.x"],
        contacts=["wall"],
    )


def bar_and_wall() -> Contents:
    return _bar(
        Fraction(300),
        Fraction(1),
        Fraction("142.5"),
        "A bar of 157.5 kN/mm, pulled by 300 kN, meets a rigid wall 1 mm away and is pushed back by 142.5 kN.",
        "l = P - k g",
    )


def bar_short_of_wall() -> Contents:
    free = Fraction(100) / BAR
    return _bar(
        Fraction(100), free, Fraction(0), "The bar under 100 kN does not reach its wall.", "u = P / k = 40/63 mm"
    )


def bar_touches_wall() -> Contents:
    return _bar(
        BAR, Fraction(1), Fraction(0), "The bar just touches its wall: gap and force are both zero.", "P = k g, l = 0"
    )


def bar_pulled_away() -> Contents:
    return _bar(
        -BAR,
        Fraction(-1),
        Fraction(0),
        "The bar is pulled away from its wall, which does not hold it: a force of -315 kN here is a glued contact.",
        "u = P / k, l = 0",
    )


def two_bars() -> Contents:
    force = Fraction(2, 3) * (300 - BAR)
    return stated(
        stiffness=[[BAR, 0], [0, SHORT_BAR]],
        load=[300, 0],
        normal=[[1, -1]],
        gap=[1],
        displacement=[1 + force / SHORT_BAR, force / SHORT_BAR],
        normal_force=[force],
        description="Two bars, 1 mm apart, one of them pulled onto the other by 300 kN.",
        source=f"{CHAPTER}, Example 2.13",
        formula="l = 2/3 (P - k1 g) = 95 kN",
        units=("mm", "kN"),
        unknowns=["1.x", "2.x"],
        contacts=["joint"],
    )


def truss_over_floor() -> Contents:
    (k11, k12), (_, k22) = TRUSS
    u = Fraction(TRUSS_LOAD[0] + k12, k11)
    return stated(
        stiffness=TRUSS,
        load=TRUSS_LOAD,
        normal=[[0, -1]],
        gap=[1],
        displacement=[u, -1],
        normal_force=[-TRUSS_LOAD[1] + k12 * u - k22],
        description="A truss of two bars is pressed on a smooth floor 1 mm below its node (stiffness as printed).",
        source=f"{CHAPTER}, Example 2.10",
        formula="u_x = (60 + K12 g) / K11, l = 100 + K12 u_x - K22 g = 180933933661/5980300000 kN",
        units=("mm", "mN"),
        unknowns=["1.x", "1.z"],
        contacts=["floor"],
    )


def _slipping_truss(mu: Fraction) -> tuple[Fraction, Fraction]:
    """Return u_x and l_N if the node slides to +x on a floor with normal force l_N and friction mu l_N."""
    (k11, k12), (_, k22) = TRUSS
    u = (TRUSS_LOAD[0] + k12 - mu * (-TRUSS_LOAD[1] - k22)) / Fraction(k11 + mu * k12)
    return u, -TRUSS_LOAD[1] + k12 * u - k22


def truss_on_rough_floor() -> Contents:
    mu = Fraction("0.3")
    u, force = _slipping_truss(mu)
    rounded = _slipping_truss(Fraction(float(mu)))
    return stated(
        stiffness=TRUSS,
        load=TRUSS_LOAD,
        normal=[[0, -1]],
        gap=[1],
        tangent=[[1, 0]],
        friction=mu,
        displacement=[u, -1],
        normal_force=[force],
        friction_force=[[mu * force]],
        description="The truss slides on a rough floor, mu = 0.3; printed is 31.337 kN, with friction along the slip.",
        source=f"{CHAPTER}, Example 2.18; mu = 0.3 is not a double, the answer belongs to 3/10",
        formula="u_x = (60 + K12 g - mu (100 - K22 g)) / (K11 + mu K12); l = 180933933661/6186793000 kN",
        units=("mm", "mN"),
        unknowns=["1.x", "1.z"],
        contacts=["floor"],
        rounding=max(abs(x / y - 1) for x, y in zip(rounded, (u, force), strict=True)),
    )


def two_masses_on_rough_floor() -> Contents:
    weights, mu, pull = (19620, 9810), Fraction(1, 4), 12000
    drag = [mu * weight for weight in weights]
    first = (pull - drag[0] - drag[1]) / 1000
    second = first + (pull - drag[1]) / 1000
    return stated(
        stiffness=[[2000, -1000, 0, 0], [-1000, 1000, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]],
        load=[0, pull, -weights[0], -weights[1]],
        normal=[[0, 0, -1, 0], [0, 0, 0, -1]],
        gap=[0, 0],
        tangent=[[1, 0, 0, 0], [0, 1, 0, 0]],
        friction=mu,
        displacement=[first, second, 0, 0],
        normal_force=weights,
        friction_force=[[force] for force in drag],
        description="Masses of 2 and 1 kg on springs of 1000 N/m slide on a rough floor, pulled by 12 N at the second.",
        source=f"{CHAPTER}, Example 2.19",
        formula="K u = F - mu m g: u = (4.6425, 14.19) mm",
        units=("mm", "mN"),
        unknowns=["1.x", "2.x", "1.z", "2.z"],
        contacts=["mass 1", "mass 2"],
        # Normal forces equal the weights for any sideways motion: a convex minimisation, with definite K along x.
        one_displacement=True,
    )


def string_over_floor() -> Contents:
    return _string(
        Fraction(1),
        [Fraction(-3, 32), *[Fraction(-1, 8)] * 5, Fraction(-3, 32)],
        [Fraction(x, 8) for x in (0, 1, 2, 2, 2, 1, 0)],
        "A string under a uniform load lies on a floor; seven nodes, exact at the nodes.",
        "x1 = sqrt(2 T d / b) = 1/2; total contact force b (L - 2 x1) = 1",
    )


def string_just_touching() -> Contents:
    free = [-Fraction(x * (8 - x), 128) for x in range(1, 8)]
    return _string(
        Fraction(1, 4),
        free,
        [Fraction(0)] * 7,
        "The string just touches the floor with its middle: gap and force are both zero there.",
        "b = 8 T d / L^2: u = -b x (L - x) / (2 T)",
    )


def _string(load: Fraction, u: list[Fraction], force: list[Fraction], description: str, formula: str) -> Contents:
    """Return the string with T = 1, L = 2, d = 1/8 and elements of 1/4: K = 4 tridiag(-1, 2, -1), consistent loads b /
    4.
    """
    nodes = range(7)
    return stated(
        stiffness=[[{0: 8, 1: -4}.get(abs(i - j), 0) for j in nodes] for i in nodes],
        load=[-load / 4] * 7,
        normal=[[-1 if i == j else 0 for j in nodes] for i in nodes],
        gap=[Fraction(1, 8)] * 7,
        displacement=u,
        normal_force=force,
        description=description,
        source=f"{CHAPTER}, Example 2.22, with linear elements",
        formula=formula,
        units=("m", "N"),
    )


def merged_chain() -> Contents:
    stiffness = (100, 200, 300, 400, 500)
    K = [[0] * 6 for _ in range(6)]
    for e, k in enumerate(stiffness):
        for i, j, sign in ((e, e, 1), (e + 1, e + 1, 1), (e, e + 1, -1), (e + 1, e, -1)):
            K[i][j] += sign * k
    return stated(
        stiffness=K,
        load=[-10, 0, 1, 2, 3, 4],
        displacement=[Fraction(x, 500) for x in (-59, -9, 16, 16, 16, 20)],
        tie=[[0, 0, 1, -1, 0, 0], [0, 0, 1, 0, -1, 0]],
        tie_force=[-2, -7],
        description="Five springs in a row, nodes 3, 4 and 5 made one; nothing holds the chain, no contact.",
        source=f"{CHAPTER}, Example 2.4, stiffnesses and loads added",
        formula="u_i = sum of N / k from node 1, less the mean of all: the smallest displacements",
        units=("m", "kN"),
    )


def master_and_slave() -> Contents:
    u = [Fraction(x, 28588) for x in (11657, 4869, 21289, 2 * 3693)]
    K = ((7, -2, 1, -1), (-2, 9, -3, 2), (1, -3, 8, -2), (-1, 2, -2, 6))
    load = (3, -1, 4, 2)
    return stated(
        stiffness=K,
        load=load,
        displacement=u,
        tie=[[0, 0, 14, -21]],
        tie_value=[5],
        tie_force=[(load[2] - sum((k * x for k, x in zip(K[2], u, strict=True)), Fraction(0))) / 14],
        description="A tie 14 d_m - 21 d_s = 5 whose right-hand side eq. 2.20 as printed forgets; no contact.",
        source=f"{CHAPTER}, eqs 2.17-2.20; our numbers",
        formula="elimination of the slave: u = (11657, 4869, 21289, 7386) / 28588",
        unknowns=["1", "2", "master", "slave"],
    )


SEED = {
    "bar-and-wall": bar_and_wall,
    "bar-short-of-wall": bar_short_of_wall,
    "bar-touches-wall": bar_touches_wall,
    "bar-pulled-away": bar_pulled_away,
    "two-bars": two_bars,
    "truss-over-floor": truss_over_floor,
    "truss-on-rough-floor": truss_on_rough_floor,
    "two-masses-on-rough-floor": two_masses_on_rough_floor,
    "string-over-floor": string_over_floor,
    "string-just-touching": string_just_touching,
    "merged-chain": merged_chain,
    "master-and-slave": master_and_slave,
}
