"""The equations by which each scheme takes a step in time, as the schemes' own modules state them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class StepSymbol:
    """A symbol of the equations below, which a motion has where it stands in those of its scheme."""

    latex: str
    meaning: str
    size: str  # n, m or 1
    unit: str  # with {length} and {force}


SYMBOLS = (
    StepSymbol("h", "length of a step", "1", "s"),
    StepSymbol(r"\theta", "weight of the end of a step; 1/2 loses no energy between impacts", "1", "1"),
    StepSymbol("e", "restitution: velocity after over velocity before an impact", "1", "1"),
    StepSymbol("P_N", "impulses of the contacts in a step, positive in compression", "m", "{force}·s"),
    StepSymbol("w", "where the step would lead without stiffness and loads, made admissible", "n", "{length}"),
    StepSymbol(r"\beta", "stiffness of the penalty springs", "1", "{force}/{length}"),
)

_FORCES = r"E_N^T \lambda_N"
# Several equations each, which lead from (u, v) to (u⁺, v⁺) in a step of h; u⁻ is a step earlier. Ties and friction
# come in as in equilibrium.
STEPS: Mapping[str, tuple[str, ...]] = {
    "moreau-jean": (
        r"M (v^+ - v) + h K (\theta u^+ + (1 - \theta) u) + E_N^T P_N = h f",
        r"u^+ = u + h (\theta v^+ + (1 - \theta) v)",
        r"E_N v^+ \le -e E_N v, \; P_N \ge 0, \; \text{complementary where a contact closes}",
    ),
    "newmark": (
        r"\frac{M (v^+ - v)}{h} + \frac{K (u + u^+)}{2} + \frac{E_N^T (\lambda_N + \lambda_N^+)}{2} = f",
        r"u^+ = u + \frac{h (v + v^+)}{2}",
    ),
    "modified-mass": (
        r"\frac{M (v^+ - v)}{h} + \frac{K (u + u^+)}{2} = f \; \text{where there is mass}",
        r"K u^+ + E_N^T \lambda_N^+ = f \; \text{at the contacts, which have none}",
    ),
    "modified-mass-central": (
        r"\frac{M (u^+ - 2 u + u^-)}{h^2} + K u = f \; \text{where there is mass}",
        r"K u^+ + E_N^T \lambda_N^+ = f \; \text{at the contacts, which have none}",
    ),
    "paoli-schatzman": (
        rf"\frac{{M (u^+ - 2 u + u^-)}}{{h^2}} + K u + {_FORCES} = f",
        r"E_N \frac{u^+ + e u^-}{1 + e} \le g",
    ),
    "penalty": (
        rf"\frac{{M (u^+ - 2 u + u^-)}}{{h^2}} + K u + {_FORCES} = f",
        r"\lambda_N = \beta \max(E_N u - g, 0)",
    ),
    "backward-euler": (
        rf"\frac{{M (v^+ - v)}}{{h}} + K u^+ + {_FORCES} = f",
        r"u^+ = u + h v^+",
    ),
    "deuflhard-krause-ertel": (
        r"w = \text{the admissible displacement nearest to } u + h v",
        rf"M (u^+ - w) + \frac{{h^2}}{{2}} \left( \frac{{K (u + u^+)}}{{2}} + {_FORCES} - f \right) = 0",
        r"v^+ = v + \frac{2 (u^+ - w)}{h}",
    ),
}


def symbols_of(scheme: str) -> Iterator[StepSymbol]:
    """Those that stand in the equations of a scheme; letters of words are none."""
    equations = re.sub(r"\\text\{[^}]*\}", "", " ".join(STEPS.get(scheme, ())))
    tokens = set(re.findall(r"\\[a-z]+|P_N|[A-Za-z]", equations))
    yield from (symbol for symbol in SYMBOLS if symbol.latex in tokens)
