"""Small valid files as CalculiX and Abaqus print them, of the problem of `valid_files`: more seeds of fuzzing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from contactqp.study.checking import check_answer
from contactqp.study.verdict import CheckOptions

STI = "1 1  4.0000000000000e+00\n1 2 -1.0000000000000e+00\n2 2  5.0000000000000e+00\n2 3  2.5000000000000e+00\n"
STI += "3 3  3.0000000000000e+00\n"
DOF = "1.1\n1.2\n2.1\n"
ABAQUS = "** K\n1,1, 1,1, 4.0e+00\n1,2, 1,1, -1.0e+00\n1,2, 1,2, 5.0e+00\n2,1, 1,2, 2.5e+00\n2,1, 2,1, 3.0e+00\n"
ABAQUS += "3,1, 2,1, -1.0e+00\n3,1, 3,1, 1.0e+36\n"
DAT = """
 displacements (vx,vy,vz) for set N and time  0.1000000E+01

         1  1.000000E-01  1.000000E-02  0.000000E+00
         2  1.000000E-02  0.000000E+00  0.000000E+00

 contact stress (slave node,press,tang1,tang2) for all contact elements and time 0.1000000E+01

         1  2.500000E-01  0.000000E+00  0.000000E+00
"""
NODAL = " -4  DISP        4    1\n" + "".join(f" -5  D{axis}          1    2    {axis}    0\n" for axis in (1, 2, 3))
PRESSED = "".join(
    f" -5  {name:8}    1    4    1    1\n" for name in ("COPEN", "CSLIP1", "CSLIP2", "CPRESS", "CSHEAR1", "CSHEAR2")
)
HEADER = "  100CL  101 1.000000000           {count}                     0    1           1\n"
FRD = (
    "    1C\n    1UPGM               CalculiX\n"
    + HEADER.format(count=2)
    + NODAL
    + " -5  ALL         1    2    0    0    1ALL\n"
    + " -1         1 1.00000E-01 1.00000E-02 0.00000E+00\n -1         2 1.00000E-02 0.00000E+00 0.00000E+00\n -3\n"
    + HEADER.format(count=1)
    + " -4  CONTACT     6    1\n"
    + PRESSED
    + " -1         1 0.00000E+00 0.00000E+00 0.00000E+00 2.50000E-01 0.00000E+00 0.00000E+00\n -3\n 9999\n"
)
Add = Callable[[str, Callable[[Path], str], Callable[[Path], object]], None]


def add_printed(add: Add, whole: Callable[..., Path]) -> None:
    """Stiffness matrices with and beside their list of unknowns, and results with contact pressures."""
    for name, mutated in {"sti": "K.sti", "dof": "K.dof", "abaqus": "K.mtx"}.items():

        def stiffness(folder: Path, mutated: str = mutated) -> str:
            place = whole(folder, "stiffness.mtx")
            (place / "dof_names.txt").write_text("1.1\n1.2\n2.1\n")
            texts = {"K.mtx": ABAQUS} if mutated == "K.mtx" else {"K.sti": STI, "K.dof": DOF}
            for file, text in texts.items():
                (place / file).write_text(text)
            return f"p/{mutated}"

        add(f"matrix-{name}", stiffness, lambda folder: _check(folder, "answer.json"))
    for file, text in {"job.frd": FRD, "job.dat": DAT}.items():

        def answer(folder: Path, file: str = file, text: str = text) -> str:
            (whole(folder) / "contact_names.txt").write_text("node 1\nnode 2\n")
            (folder / "areas.csv").write_text("contact,area\nnode 1,2.0\nnode 2,1.0\n")
            (folder / file).write_text(text)
            return file

        add(f"answer-{file}", answer, lambda folder, file=file: _check(folder, file, str(folder / "areas.csv")))


def _check(folder: Path, candidate: str, areas: str | None = None) -> object:
    return check_answer(str(folder / "p"), str(folder / candidate), CheckOptions(pressure_areas=areas)).data()
