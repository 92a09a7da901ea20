"""Siconos's text files of frictional contact.

    dimension, contacts, W, q, mu                 local:   u = W r + q
    dimension, contacts, M, H, f, w, mu           global:  M v = H r + f,  u = H'v + w

Old versions end a local file with one more number, 0 or 1. Nothing in a file says which of the two it is: it is local
if its first matrix has the size of the contacts and what follows it is q and mu. Names of files say nothing.
"""

from __future__ import annotations

from contactqp.exchange.fclib import solvable
from contactqp.exchange.refusal import Path, check_dimension, check_friction, naming, wrong
from contactqp.exchange.siconos_matrix import read_matrix
from contactqp.exchange.siconos_numbers import Words
from contactqp.model.global_problem import GlobalProblem
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem

# What old versions of Siconos put at the end: whether a problem is complete.
COMPLETE = ("0", "1")
# The shortest matrix that can follow: storage, rows, columns.
MATRIX_HEAD = 3


def read_siconos(path: Path, *, as_stored: bool = False) -> ContactProblem | LocalProblem | GlobalProblem:
    """The problem in a text file of Siconos; returns as `read_fclib`.

    Sparse matrices (storage 2) stand in the file with six digits: what is read is that problem, not the one that
    Siconos had in memory.

    Raises
    ------
    InvalidProblem
        No such file, text that ends early or goes on, a word that is no number, sizes that do not agree, NaN.
    Unsupported
        Contacts that resist rolling.
    """
    stored = _read(Words(path))
    return stored if as_stored else solvable(stored, path)


def _read(words: Words) -> LocalProblem | GlobalProblem:
    d = check_dimension(words.path, "dimension", words.integer("dimension"))
    m = words.size("number of contacts")
    matrix = read_matrix(words, "first matrix")
    rows, columns = matrix.shape
    if rows != columns:
        raise wrong(words.path, "first matrix", "a square one (W or M)", matrix.shape)
    tail, bodies = (d + 1) * m, MATRIX_HEAD + rows + (d + 1) * m
    if rows == d * m and words.left < bodies:
        _refuse_head_of_matrix(words, rows)
        q, mu = words.numbers(d * m, "q"), words.numbers(m, "mu")
        _end(words, f"the {tail} numbers of q and mu")
        check_friction(words.path, "mu", mu)
        with naming(words.path):
            return LocalProblem(delassus=matrix, offset=q, friction=mu, dimension=d)
    H = read_matrix(words, "H", (rows, d * m))
    f, w, mu = words.numbers(rows, "f"), words.numbers(d * m, "w"), words.numbers(m, "mu")
    _end(words, "mu")
    check_friction(words.path, "mu", mu)
    with naming(words.path):
        return GlobalProblem(matrix=matrix, directions=H, load=f, offset=w, friction=mu, dimension=d)


def _refuse_head_of_matrix(words: Words, size: int) -> None:
    """A global file that ends within H must not pass for a local one; q is written with decimal points."""
    if words.left >= MATRIX_HEAD and words.ahead(MATRIX_HEAD) in ([storage, f"{size}", f"{size}"] for storage in "012"):
        found = " ".join(words.ahead(MATRIX_HEAD))
        raise wrong(words.path, "after the first matrix", "q, or the whole of a second matrix", f"{found!r}, its head")


def _end(words: Words, after: str) -> None:
    if words.left == 1 and words.peek() in COMPLETE:
        return
    if words.left:
        raise wrong(words.path, f"after {after}", "the end", f"{words.left} more, beginning with {words.peek()!r:.40}")
