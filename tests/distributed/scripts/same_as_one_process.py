"""The problem of a shipped case in pieces is that of one process: K, loads, contacts, names, on any number of ranks."""

import sys
from fractions import Fraction
from pathlib import Path

import numpy as np

import contactqp as cq
from contactqp.distributed.distributed_bodies import distributed_model
from contactqp.distributed.ranks import Ranks
from contactqp.linalg.measures import bodies
from contactqp.scene.building import build

ranks = Ranks()
ROUNDING = 1e-12


def close(a, b, what):
    size = np.max(np.abs(b), initial=0.0)
    assert a.shape == b.shape, f"{what}: {a.shape} and {b.shape}"
    assert np.max(np.abs(a - b), initial=0.0) <= ROUNDING * size, f"{what}: off by {np.max(np.abs(a - b))} of {size}"


def compare(path, spoil):
    scene = cq.load_scene(path)
    serial, model = build(scene), distributed_model(scene, ranks)
    one, d = serial.problem, model.problem
    if spoil and ranks.rank == ranks.size - 1:
        d.load[np.flatnonzero(~d.constrained)[0]] += 1e-9 * np.abs(one.load).max()
    n, m = one.dimension, one.contacts
    assert m > 0
    assert d.dimension == n
    assert int(ranks.sum(d.contacts)) == m
    assert np.array_equal(d.constrained, d.dof_number < 0)

    def whole(values):
        return d.gathered(values, d.dof_number)

    assert np.array_equal(np.sort(whole(d.dof_number)), np.arange(n)), "every free unknown has one rank"
    u = np.random.default_rng(1).standard_normal(n)
    here = np.where(d.constrained, 0.0, u[d.dof_number])
    close(whole(d.product(here)), one.stiffness @ u, "K u")
    close(whole(d.diagonal), one.stiffness.diagonal(), "diagonal of K")
    assert np.all(d.diagonal > 0)
    held_only = np.where(d.constrained, 1.0, 0.0)
    close(d.product(held_only), np.where(d.constrained, d.diagonal, 0.0), "rows of held unknowns")
    close(whole(d.load), one.load, "load")
    assert not d.load[d.constrained].any()
    assert not d.near_null_space[d.constrained].any()
    close(d.gathered(d.normal.lengths(here), d.contact_number), one.normal @ u, "E_N u")
    close(d.gathered(d.gap, d.contact_number), one.gap, "gap")
    force = np.random.default_rng(2).standard_normal(m)
    close(whole(d.normal.forces(force[d.contact_number])), one.normal.T @ force, "E_N' l")
    close(whole(d.near_null_space), one.near_null_space, "rigid motions")
    assert np.array_equal(whole(d.body), bodies(one)), "bodies"
    for i, number in enumerate(d.contact_number):
        assert d.contact_name(i) == one.contact_name(int(number))
    for i in np.flatnonzero(~d.constrained)[::7]:
        assert d.dof_name(int(i)) == one.dof_name(int(d.dof_number[i]))
    assert (d.tangent is None) == (one.tangent is None)
    if d.tangent is not None:
        per = one.slip_origin.shape[1]
        slips = d.tangent.lengths(here).reshape(-1, per)
        close(d.gathered(slips, d.contact_number), (one.tangent @ u).reshape(-1, per), "E_T u")
        close(d.gathered(d.friction, d.contact_number), one.friction, "friction")
        close(d.gathered(d.slip_origin, d.contact_number), one.slip_origin, "slip origin")
    for ours, theirs in zip(model.contacts, serial.contacts, strict=True):
        close(ours.pairing.area, theirs.pairing.area, "areas")
        assert np.array_equal(ours.pairing.nodes, theirs.pairing.nodes)
    for time in (Fraction(1, 3), Fraction(1)):
        close(whole(model.load_at(time)), serial.load_at(time), f"load at {time}")


spoiled = "--spoil" in sys.argv
for path in sys.argv[1 + spoiled :]:
    compare(Path(path), spoiled)
    if ranks.rank == 0:
        print(f"{Path(path).stem}: the same on {ranks.size}", flush=True)
