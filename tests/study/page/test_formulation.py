"""The equations on the page: those of the blocks that a case has, with its sizes and the signs of the package."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import pytest

from contactqp.analysis.motion.schemes import SCHEMES
from contactqp.scene.explaining import explain
from contactqp.scene.scene import load_scene
from contactqp.study.page import formulation as pages
from contactqp.study.page.formulation import STEPS, SYMBOLS, Formulation, formulation
from contactqp.study.page.render import mathml
from tests.study.page.samples import CASES, bare_record

pytest.importorskip("latex2mathml")


def _of(name: str) -> Formulation:
    return formulation(bare_record(name))


def _names(found: Formulation) -> list[str]:
    return [formula.name for formula in found.formulas]


def _latex(found: Formulation, name: str) -> str:
    return next(formula.latex for formula in found.formulas if formula.name == name)


def _sizes(found: Formulation) -> dict[str, str]:
    return {symbol.latex: symbol.size for symbol in found.symbols}


def test_a_bar_at_a_wall_has_an_energy_and_a_contact_and_nothing_else() -> None:
    found = _of("bar_wall")
    assert _names(found) == ["Energy", "Contact", "Equilibrium", "Signorini"]
    assert _latex(found, "Equilibrium") == r"K u + E_N^T \lambda_N  = f"
    assert set(_sizes(found)) == {"u", "K", "f", "E_N", "g", r"\lambda_N"}
    assert _sizes(found)["K"] == r"1 \times 1"


def test_friction_is_no_minimisation_and_has_its_cone() -> None:
    found = _of("truss_friction")
    assert _latex(found, "Equilibrium") == r"K u + E_N^T \lambda_N + E_T^T \lambda_T  = f(t)"
    meanings = {formula.name: formula.meaning for formula in found.formulas}
    assert "not a minimisation" in meanings["Energy"]
    assert "Karush" not in meanings["Equilibrium"]
    assert "Karush" in next(f.meaning for f in _of("bar_wall").formulas if f.name == "Equilibrium")
    assert _latex(found, "Coulomb").endswith(r"\lambda_{T,i} = \mu_i \lambda_{N,i} \frac{s_i}{\lVert s_i \rVert}")
    assert _sizes(found)["E_T"] == r"(d - 1) m \times n = 1 \times 2"


def test_ties_without_contacts() -> None:
    found = _of("tie_symmetry")
    assert "Signorini" not in _names(found)
    assert _latex(found, "Equilibrium") == r"K u + A^T \nu  = f"
    assert _sizes(found)["A, b"].endswith(f"k = {bare_record('tie_symmetry').sizes.ties}")


def test_a_motion_has_mass_and_the_equation_of_its_scheme() -> None:
    found, scheme = _of("bar_impact"), bare_record("bar_impact").scheme
    assert _latex(found, f"One step of h by {scheme}").splitlines() == list(STEPS[scheme])
    assert "Motion" in _names(found)
    assert "Energy" not in _names(found)
    units = {symbol.latex: symbol.unit for symbol in found.symbols}
    assert units["M"] == "N·s²/m"
    assert {name: units[name] for name in ("v", "h", r"\theta", "e", "P_N")} == {
        "v": "m/s",
        "h": "s",
        r"\theta": "1",
        "e": "1",
        "P_N": "N·s",
    }
    assert "w" not in units  # which other schemes have


def test_every_symbol_of_a_scheme_is_explained() -> None:
    explained = {symbol.latex for symbol in SYMBOLS}
    known = {"u", "v", "K", "M", "E_N", r"\lambda_N", "f", "g"}
    assert len(STEPS) >= 6
    for name, lines in STEPS.items():
        words = re.sub(r"\\text\{[^}]*\}|\\(frac|left|right|ge|le|max)(?![a-z])", " ", " ".join(lines))
        found = set(re.findall(r"\\[a-z]+(?:_N)?|E_N|P_N|[A-Za-z]", words.replace("E_N^T", "E_N")))
        assert found - known <= explained, name


def test_large_displacements_have_newton_steps_and_gaps_that_change() -> None:
    found = _of("von_mises_snaps")
    assert "One step of Newton" in _names(found)
    assert "g(u)" in _latex(found, "Signorini")
    assert {r"\Delta", r"\mathrm{U}"} <= set(_sizes(found))


def test_every_scheme_has_its_equation() -> None:
    assert set(STEPS) == set(SCHEMES)


@pytest.mark.parametrize(
    ("case", "names"),
    [
        ("two_bars_path", {pages.PATH, pages.TIME, pages.NEWTON, pages.ROTATIONS, pages.CONDENSATION}),
        ("hertz_line", {pages.PATH, pages.TIME, pages.NEWTON, pages.CONDENSATION}),
    ],
)
def test_blocks_that_have_equations_are_called_so_in_explanations(case: str, names: set[str]) -> None:
    blocks = {block.name for block in explain(load_scene(CASES / f"{case}.toml")).blocks}
    assert names <= blocks


def test_formulas_are_well_formed() -> None:
    stated = [formula.latex for name in ("truss_friction", "von_mises_snaps") for formula in _of(name).formulas]
    assert len(stated) > 4
    assert STEPS
    for latex in [line for lines in (*STEPS.values(), stated) for line in lines]:
        tree = ElementTree.fromstring(mathml(latex, "block"))
        assert tree.tag.endswith("math")
        assert "\\" not in "".join(tree.itertext())  # every command was understood
