"""Gradients and Hessians held against finite differences, with a guard that what is compared is not zero."""

from __future__ import annotations

import numpy as np

# A central difference of step h of numbers of order one errs by h^2 and by eps / h.
STEP = 1e-6


def check_derivatives(body, displacement, tolerance=1e-7):
    """internal_force is the gradient of energy, tangent the derivative of internal_force, and neither is nothing.

    Lengths, moduli and areas of the body should be of order one.
    """
    u = np.asarray(displacement, dtype=float)
    force, K = body.internal_force(u), np.asarray(body.tangent(u).toarray())
    steps = STEP * np.eye(len(u))
    gradient = np.array([(body.energy(u + h) - body.energy(u - h)) / (2 * STEP) for h in steps])
    hessian = np.array([(body.internal_force(u + h) - body.internal_force(u - h)) / (2 * STEP) for h in steps]).T
    assert np.abs(gradient).max() > 1e-3, "the gradient is nothing: the test shows nothing"
    assert np.abs(hessian).max() > 1e-3, "the Hessian is nothing: the test shows nothing"
    np.testing.assert_allclose(force, gradient, rtol=0, atol=tolerance * max(1.0, np.abs(gradient).max()))
    np.testing.assert_allclose(K, hessian, rtol=0, atol=tolerance * max(1.0, np.abs(hessian).max()))
    assert np.abs(K - K.T).max() == 0
