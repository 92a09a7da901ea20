"""Run the codes that are installed, print their verdicts, write the page.

python -m benchmarks.crosscheck                        # a table; exit code 1 where something is not as expected
python -m benchmarks.crosscheck --write                # and docs/crosscheck.md, where all four are installed
python -m benchmarks.crosscheck --keep answers         # leaves problems, decks and answers in a folder
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from benchmarks.crosscheck import calculix, peers
from benchmarks.crosscheck.attempts import ATTEMPTS
from benchmarks.crosscheck.judging import Judged, judge, own_stiffness, prepare
from benchmarks.crosscheck.page import page

PAGE = Path(__file__).parent.parent.parent / "docs" / "crosscheck.md"


def available(code: str) -> bool:
    return calculix.available() if code == "CalculiX" else peers.available(code)


def run(folder: Path) -> tuple[dict[str, list[Judged]], float | None]:
    """All attempts of the codes that are installed, and how far CalculiX's stiffness is from ours."""
    prepare(folder)
    same = own_stiffness(folder) if calculix.available() else None
    found = {code: [judge(one, folder) for one in asked] for code, asked in ATTEMPTS.items() if available(code)}
    return found, same


def as_expected(one: Judged) -> bool:
    """Whether verdict and findings are what the attempt says."""
    kinds = {finding.kind for finding in one.verdict.certificate.findings}
    return one.word == one.attempt.verdict and set(one.attempt.kinds) <= kinds


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write docs/crosscheck.md")
    parser.add_argument("--keep", metavar="FOLDER", type=Path, help="where problems and answers are left")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        found, same = run(folder)
        text = page(found, same)
    everything = [one for results in found.values() for one in results]
    for one in everything:
        mark = "" if as_expected(one) else "   NOT AS EXPECTED"
        print(f"{one.attempt.code:9} {one.attempt.name:46} {one.word:6} {one.force_error:8.1e}  {one.said}{mark}")
    missing = [code for code in ATTEMPTS if code not in found]
    if missing:
        print(f"not installed: {', '.join(missing)}")
    if given.write and not missing:
        PAGE.write_text(text, encoding="utf-8")
    return 0 if all(map(as_expected, everything)) else 1


if __name__ == "__main__":
    sys.exit(main())
