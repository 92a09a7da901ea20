"""What a certificate that passes says itself of an error: then the error is not a silent one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from contactqp.certificate.bounds import REDUNDANT
from contactqp.certificate.uniqueness import FORCES, SEVERAL
from contactqp.model.solution import Solution
from contactqp.study.stability.posed import SweptTruth

# What the nearest doubles of a truth may add to an error that meets its bound exactly.
ROUNDING = 1e-12


def stated(truth: SweptTruth, solution: Solution) -> str:
    """What the certificate says of an answer that it passes and that is off by more than 1e-6; empty: nothing.

    That uniqueness was not examined, or that other answers are not excluded, says nothing of this one.
    """
    certificate = solution.certificate
    if SEVERAL in certificate.uniqueness:
        return f"the certificate says: {'; '.join(certificate.uniqueness)}"
    if not truth.exists:
        return ""
    if certificate.force_bound is None:
        said = [reason for reason in certificate.reasons if reason.startswith("force_bound") and REDUNDANT in reason]
        said += [finding for finding in certificate.uniqueness if finding == FORCES]
        resultants = replace(truth, unique_forces=False)
        errors = resultants.errors(solution.displacement, solution.normal_force, solution.tie_force)
        return f"the certificate says: {said[0]}" if said and errors.small else ""
    off = np.abs(solution.normal_force - truth.normal_force)
    allowed = certificate.force_bound + ROUNDING * np.abs(truth.normal_force)
    together = replace(truth, unique_forces=False).errors(solution.displacement, truth.normal_force, solution.tie_force)
    if bool(np.all(off <= allowed)) and together.small:
        return f"the certificate's own force bound is {float(np.max(certificate.force_bound)):.1e}"
    return ""
