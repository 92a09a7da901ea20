"""Random lattices of bars that hang over a tilted floor and a ball: many contacts, snaps, all laws."""

from __future__ import annotations

import numpy as np

import contactqp as cq

LAWS = ("green", "engineering", "logarithmic")


def lattice(seed, columns=4):
    """A cantilever of crossed bars, its contacts, and a load: (body, contact, load)."""
    random = np.random.default_rng(seed)
    nodes = np.array([[i, j] for i in range(columns) for j in range(2)], dtype=float)
    nodes += 0.15 * random.uniform(-1, 1, nodes.shape)
    bars = [(2 * i, 2 * i + 1) for i in range(columns)]
    for i in range(0, 2 * columns - 2, 2):
        bars += [(i, i + 2), (i + 1, i + 3), (i, i + 3), (i + 1, i + 2)]
    truss = cq.NonlinearTruss(nodes, bars, random.uniform(1, 3, len(bars)), 1.0, LAWS[seed % 3])
    body = cq.Supported(truss, held=[0, 1, 2, 3])
    low = [2 * i for i in range(1, columns)]
    places = np.array([[2 * i, 2 * i + 1] for i in low])
    floor = cq.Plane([0, -0.3 - 0.3 * random.random()], [0.3 * random.uniform(-1, 1), 1])
    ball = cq.Circle([3 + random.uniform(-0.5, 0.5), -1.6], 1.0)
    obstacles = [cq.ObstacleContact(nodes[low], obstacle, places, truss.dimension) for obstacle in (floor, ball)]
    load = np.zeros(truss.dimension)
    load[1::2] = -random.uniform(0.1, 0.5) * random.random(len(nodes))
    load[0::2] = 0.2 * random.uniform(-1, 1, len(nodes))
    return body, body.contact(cq.ContactGroup(obstacles)), body.restrict(load)
