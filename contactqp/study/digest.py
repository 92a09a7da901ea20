"""A short text that is another one where a case is another one."""

from __future__ import annotations

import hashlib
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.model.problem import ContactProblem

# Bytes: two cases of one report never have the same by chance.
SIZE = 12


def digest(file: bytes, problem: ContactProblem) -> str:
    """Of the bytes of a case file, and of every number of its problem, some of which may come from other files."""
    found = hashlib.blake2b(file, digest_size=SIZE)
    for field in fields(problem):
        if not field.name.startswith("_"):
            found.update(field.name.encode())
            for part in _parts(getattr(problem, field.name)):
                found.update(part)
    return found.hexdigest()


def source_digest() -> str:
    """Of the package's own source: results of code that was changed since are not mixed with new ones."""
    found = hashlib.blake2b(digest_size=SIZE)
    for file in sorted(Path(__file__).parents[1].rglob("*.py")):
        found.update(file.read_bytes())
    return found.hexdigest()


def _parts(value: Any) -> list[bytes]:
    if sp.issparse(value):
        rows = value.tocsr()
        return [np.ascontiguousarray(part).tobytes() for part in (rows.indptr, rows.indices, rows.data)]
    if isinstance(value, np.ndarray):
        return [str(value.shape).encode(), np.ascontiguousarray(value).tobytes()]
    return [repr(value).encode()]
