"""Parts of a long list of tests: together they are all of them, and the same ones every time."""

from __future__ import annotations

import pytest

TESTS = "import pytest\n@pytest.mark.parametrize('n', range(40))\ndef test_one(n): pass\n"


@pytest.mark.slow
def test_shares_are_disjoint_and_make_up_the_whole(pytester: pytest.Pytester, request: pytest.FixtureRequest) -> None:
    pytester.makeconftest((request.config.rootpath / "tests" / "conftest.py").read_text())
    pytester.makepyfile(TESTS)
    collected = []
    for part in range(3):
        result = pytester.runpytest_subprocess("--collect-only", "-q", "--share", f"{part}/3", "-p", "no:cacheprovider")
        found = [line for line in result.outlines if "::test_one" in line]
        assert 0 < len(found) < 40
        collected += found
    assert len(collected) == len(set(collected)) == 40
