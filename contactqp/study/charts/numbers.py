"""Numbers in charts: rounded as data, so that pages stay small, and written as text."""

from __future__ import annotations

# Digits that a screen can show.
DIGITS = 4


def rounded(value: float) -> float:
    """To four digits.

    >>> rounded(0.0123456), rounded(1234567.0)
    (0.01235, 1235000.0)
    """
    return float(f"{value:.{DIGITS}g}")


def error_text(value: float | None) -> str:
    """An error in a table.

    >>> error_text(3.14e-9), error_text(0.0), error_text(None)
    ('3.1e-09', '0', '')
    """
    return "" if value is None else "0" if value == 0 else f"{value:.1e}"


def milliseconds(seconds: float | None) -> str:
    """A time in a table [ms].

    >>> milliseconds(0.01234), milliseconds(None)
    ('12.3', '')
    """
    return "" if seconds is None else f"{1e3 * seconds:.3g}"


def percent(part: int, whole: int) -> str:
    """Of nothing, nothing.

    >>> percent(1, 3), percent(0, 0)
    ('33 %', '')
    """
    return f"{100 * part / whole:.0f} %" if whole else ""


def plural(count: int, word: str) -> str:
    """A number of things.

    >>> plural(1, "case"), plural(2, "case")
    ('1 case', '2 cases')
    """
    return f"{count} {word}{'' if count == 1 else 's'}"
