"""The equations by which each scheme takes a step in time, as the schemes' own modules state them."""

from __future__ import annotations

from collections.abc import Mapping

_FORCES = r"E_N^T \lambda_N"
# One step from (u, v) to (u⁺, v⁺), h long; u⁻ is a step earlier. Ties and friction come in as in equilibrium.
STEPS: Mapping[str, str] = {
    "moreau-jean": (
        r"M (v^+ - v) + h K (\theta u^+ + (1 - \theta) u) + E_N^T P_N = h f, \quad "
        r"u^+ = u + h (\theta v^+ + (1 - \theta) v), \quad "
        r"E_N v^+ \le -e E_N v, \; P_N \ge 0, \; \text{complementary where a contact closes}"
    ),
    "newmark": (
        r"\frac{M (v^+ - v)}{h} + \frac{K (u + u^+)}{2} + \frac{E_N^T (\lambda_N + \lambda_N^+)}{2} = f, \quad "
        r"u^+ = u + \frac{h (v + v^+)}{2}"
    ),
    "modified-mass": (
        r"\frac{M (v^+ - v)}{h} + \frac{K (u + u^+)}{2} = f \; \text{where there is mass}, \quad "
        r"K u^+ + E_N^T \lambda_N^+ = f \; \text{at the contacts, which have none}"
    ),
    "modified-mass-central": (
        r"\frac{M (u^+ - 2 u + u^-)}{h^2} + K u = f \; \text{where there is mass}, \quad "
        r"K u^+ + E_N^T \lambda_N^+ = f \; \text{at the contacts, which have none}"
    ),
    "paoli-schatzman": (
        rf"\frac{{M (u^+ - 2 u + u^-)}}{{h^2}} + K u + {_FORCES} = f, \quad "
        r"E_N \frac{u^+ + e u^-}{1 + e} \le g"
    ),
    "penalty": (
        rf"\frac{{M (u^+ - 2 u + u^-)}}{{h^2}} + K u + {_FORCES} = f, \quad "
        r"\lambda_N = \beta \max(E_N u - g, 0)"
    ),
    "backward-euler": rf"\frac{{M (v^+ - v)}}{{h}} + K u^+ + {_FORCES} = f, \quad u^+ = u + h v^+",
    "deuflhard-krause-ertel": (
        r"w = \text{the admissible displacement nearest to } u + h v, \quad "
        rf"M (u^+ - w) + \frac{{h^2}}{{2}} \left( \frac{{K (u + u^+)}}{{2}} + {_FORCES} - f \right) = 0, \quad "
        r"v^+ = v + \frac{2 (u^+ - w)}{h}"
    ),
}
