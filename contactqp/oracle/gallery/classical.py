"""Gallery problems with closed-form answers: statics, Coulomb's law, beams, floating bodies."""

from __future__ import annotations

from fractions import Fraction

from contactqp.oracle.gallery.problem import Contents, stated

KLARBRING = (
    "A. Klarbring, Examples of non-uniqueness and non-existence of solutions to quasistatic contact problems with "
    "friction, Ingenieur-Archiv 60 (1990) 529-541; our numbers"
)
HAND = "equilibrium by hand"


def _klarbring(
    mu: Fraction, push: Fraction, u: tuple[Fraction, Fraction], normal: Fraction, drag: Fraction, description: str
) -> Contents:
    return stated(
        stiffness=[[1, -2], [-2, 5]],
        load=[push, -1],
        normal=[[0, -1]],
        gap=[0],
        tangent=[[1, 0]],
        friction=mu,
        displacement=u,
        normal_force=[normal],
        friction_force=[[drag]],
        description=description,
        source=KLARBRING,
        formula="critical mu = K11 / |K12| = 1/2; stuck l = (1, P), sliding u_x = (P - mu) / (1 - 2 mu)",
        units=("m", "N"),
        unknowns=["1.x", "1.z"],
        contacts=["foot"],
        one_displacement=mu < Fraction(1, 2),
    )


def klarbring_below_critical() -> Contents:
    return _klarbring(
        Fraction(1, 4),
        Fraction(3, 8),
        (Fraction(1, 4), Fraction(0)),
        Fraction(1, 2),
        Fraction(1, 8),
        "One node on a rough floor, mu = 1/4 below the critical 1/2: it slides, and no other answer exists.",
    )


def klarbring_sticks() -> Contents:
    return _klarbring(
        Fraction(3, 4),
        Fraction(5, 8),
        (Fraction(0), Fraction(0)),
        Fraction(1),
        Fraction(5, 8),
        "The node with mu = 3/4 above the critical 1/2 sticks; it could slide or be open under the same load.",
    )


def klarbring_slides() -> Contents:
    return _klarbring(
        Fraction(3, 4),
        Fraction(5, 8),
        (Fraction(1, 4), Fraction(0)),
        Fraction(1, 2),
        Fraction(3, 8),
        "The node with mu = 3/4 above the critical 1/2 slides; it could stick or be open under the same load.",
    )


def klarbring_opens() -> Contents:
    return _klarbring(
        Fraction(3, 4),
        Fraction(5, 8),
        (Fraction(9, 8), Fraction(1, 4)),
        Fraction(0),
        Fraction(0),
        "The node with mu = 3/4 above the critical 1/2 is open; it could stick or slide under the same load.",
    )


def _pad(pull: int, extension: Fraction, drag: Fraction, description: str) -> Contents:
    """Return a plane with the normal (-3, 4) / 5 and rows five times as long, so that multipliers are a fifth of forces
    in N.
    """
    return stated(
        stiffness=[[640, 480], [480, 360]],
        load=[7200 + Fraction(4 * pull, 5), -9600 + Fraction(3 * pull, 5)],
        normal=[[3, -4]],
        gap=[0],
        tangent=[[4, 3]],
        friction=Fraction(1, 4),
        displacement=[extension * 4 / 5, extension * 3 / 5],
        normal_force=[2400],
        friction_force=[[drag / 5]],
        description=description,
        source=HAND,
        formula="mu N = 3000 N; what friction does not hold, over 1000 N/m",
        units=("m", "N"),
        unknowns=["pad.x", "pad.z"],
        contacts=["incline"],
        # Normal and tangential motion are uncoupled: N = 12000 N for any slip, and K on the plane is definite.
        one_displacement=True,
    )


def pad_sticks() -> Contents:
    return _pad(2500, Fraction(0), Fraction(2500), "A pad, pressed on an incline by 12000 N, holds a pull of 2500 N.")


def pad_slides() -> Contents:
    return _pad(
        3125, Fraction(1, 8), Fraction(3000), "The pad slides up the incline under 3125 N until a spring takes 125 N."
    )


def pad_slides_in_space() -> Contents:
    return stated(
        stiffness=[[2, 0, 0], [0, 2, 0], [0, 0, 0]],
        load=[21, 28, -50],
        normal=[[0, 0, -1]],
        gap=[0],
        tangent=[[1, 0, 0], [0, 1, 0]],
        friction=Fraction(1, 2),
        displacement=[3, 4, 0],
        normal_force=[50],
        friction_force=[[15, 20]],
        description="A pad on a floor in space, pulled by 35 N along (3, 4) / 5, slides that way; friction holds 25 N.",
        source=HAND,
        formula="u = (35 - mu 50) / 2 (3, 4) / 5",
        units=("m", "N"),
        unknowns=["pad.x", "pad.y", "pad.z"],
        contacts=["floor"],
        one_displacement=True,  # as on the incline
    )


def wedge() -> Contents:
    return stated(
        stiffness=[[0, 0], [0, 0]],
        load=[6, -40],
        normal=[[-3, -4], [3, -4]],
        gap=[0, 0],
        displacement=[0, 0],
        normal_force=[4, 6],
        description="A rigid roller in a groove with walls (3, 4) / 5 and (-3, 4) / 5, without springs; rows times 5.",
        source=HAND,
        formula="4 (l1 + l2) = 40, 3 (l2 - l1) = 6",
        units=("m", "N"),
        unknowns=["roller.x", "roller.z"],
        contacts=["left wall", "right wall"],
    )


def stacked_blocks() -> Contents:
    weights, k = (8, 16, 32), 64
    K = [[0] * 6 for _ in range(6)]
    for block in range(3):
        low, high = 2 * block, 2 * block + 1
        K[low][low] = K[high][high] = k
        K[low][high] = K[high][low] = -k
    # Each block is shortened by half of its weight and the whole load above it.
    u, height = [], Fraction(0)
    for block in range(3):
        carried = Fraction(weights[block], 2) + sum(weights[block + 1 :])
        u += [height, height - carried / k]
        height = u[-1]
    return stated(
        stiffness=K,
        load=[-Fraction(weights[node // 2], 2) for node in range(6)],
        normal=[[-1, 0, 0, 0, 0, 0], [0, 1, -1, 0, 0, 0], [0, 0, 0, 1, -1, 0]],
        gap=[0, 0, 0],
        displacement=u,
        normal_force=[56, 48, 32],
        description="Three elastic blocks lie on each other and on the ground by nothing but their weight.",
        source=HAND,
        formula="each joint carries what is above it",
        units=("m", "N"),
        unknowns=[f"block {i + 1} {end}" for i in range(3) for end in ("bottom", "top")],
        contacts=["ground", "lower joint", "upper joint"],
    )


def floating_disc() -> Contents:
    return stated(
        stiffness=[[0, 0, 0], [0, 16, -16], [0, -16, 16]],
        load=[0, -8, 0],
        normal=[[0, 0, -1]],
        gap=[0],
        displacement=[0, Fraction(-1, 2), 0],
        normal_force=[8],
        description="A heavy disc rests on a smooth plane by a soft rim; it may slide away, nothing drives it.",
        source=HAND,
        formula="l = W, u_z = -W / k; u_x = 0 is the smallest displacement",
        units=("m", "N"),
        unknowns=["centre.x", "centre.z", "rim.z"],
        contacts=["plane"],
    )


def redundant_stops() -> Contents:
    return stated(
        stiffness=[[2]],
        load=[12],
        normal=[[1], [1]],
        gap=[1, 1],
        displacement=[1],
        normal_force=[5, 5],
        description="A slide meets two equal stops at once: together they push back by 10, how they share it is open.",
        source=HAND,
        formula="l1 + l2 = P - k g; the smallest forces are equal",
    )


def four_legged_table() -> Contents:
    legs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    return stated(
        stiffness=[[2, 0, 0], [0, 0, 0], [0, 0, 0]],
        load=[-10, -2, 1],
        normal=[[-1, -y, x] for x, y in legs],
        gap=[1] * 4,
        displacement=[-1, 0, 0],
        normal_force=[2 + Fraction(x, 4) + Fraction(y, 2) for x, y in legs],
        description=(
            "A rigid table of weight 10, hung by its middle on a spring of 2, sinks by 1 onto four legs at (+-1, +-1); "
            "its weight is off the middle."
        ),
        source="a body on four supports: three equations, four forces",
        formula="sum l = 10 - k = 8, sum l x = 1, sum l y = 2; the smallest forces are linear in x and y",
        unknowns=["w", "slope.y", "-slope.x"],
        contacts=["leg ++", "leg -+", "leg --", "leg +-"],
    )


def cantilever_on_stop() -> Contents:
    return stated(
        stiffness=[[12, -6], [-6, 4]],
        load=[12, -2],
        normal=[[1, 0]],
        gap=[Fraction(3, 2)],
        displacement=[Fraction(3, 2), Fraction(7, 4)],
        normal_force=[Fraction(9, 2)],
        description="A clamped beam (E I = L = 1) under the uniform load 24 meets a stop at half its free deflection.",
        source="Euler-Bernoulli beam, one cubic element with consistent loads, exact at its ends",
        formula="l = 3 E I / L^3 (q L^4 / (8 E I) - g) = 9/2",
        unknowns=["tip.w", "tip.slope"],
        contacts=["stop"],
    )


def press_fit() -> Contents:
    return stated(
        stiffness=[[1, 0], [0, 3]],
        load=[0, 0],
        normal=[[1, -1]],
        gap=[-1],
        displacement=[Fraction(-3, 4), Fraction(1, 4)],
        normal_force=[Fraction(3, 4)],
        description="A pin is larger than its hole by 1: no load, a negative gap, and a pressure that fits them.",
        source=HAND,
        formula="l = overlap / (1/k1 + 1/k2) = 3/4",
        unknowns=["pin", "hole"],
        contacts=["fit"],
    )


def falling_dominoes() -> Contents:
    return stated(
        stiffness=[[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        load=[10, 0, 0],
        normal=[[1, -1, 0], [0, 1, -1], [0, 0, 1]],
        gap=[1, 1, 1],
        displacement=[3, 2, 1],
        normal_force=[7, 5, 4],
        description="The first of three slides pushes the second, that the third, and that a wall: gaps close in turn.",
        source=HAND,
        formula="u = (3, 2, 1); l = (P - 3, P - 5, P - 6)",
    )


CLASSICAL = {
    "klarbring-below-critical": klarbring_below_critical,
    "klarbring-sticks": klarbring_sticks,
    "klarbring-slides": klarbring_slides,
    "klarbring-opens": klarbring_opens,
    "pad-sticks": pad_sticks,
    "pad-slides": pad_slides,
    "pad-slides-in-space": pad_slides_in_space,
    "wedge": wedge,
    "stacked-blocks": stacked_blocks,
    "floating-disc": floating_disc,
    "redundant-stops": redundant_stops,
    "four-legged-table": four_legged_table,
    "cantilever-on-stop": cantilever_on_stop,
    "press-fit": press_fit,
    "falling-dominoes": falling_dominoes,
}
