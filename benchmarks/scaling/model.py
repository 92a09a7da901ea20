"""What the measured figures make of more unknowns on more nodes than can be had here: a simple, stated model.

For n unknowns on P ranks, N = n / P unknowns a rank, one step of conjugate gradients takes

    t = BYTES_PER_FLOP f N / B  +  m k(P) alpha  +  s k(P) N^(2/3) beta  +  r 2 log2(P) alpha

with f flops an unknown (measured), B the memory bandwidth of a rank, m messages a neighbour and step, s bytes a
neighbour and step over N^(2/3) (both measured on two ranks, where each has one neighbour), k neighbours, r the times
that all ranks meet in a step (measured), alpha the network's latency and beta its seconds a byte for one rank. Contact
takes c linear solutions (measured), the set-up of the multigrid as long as u steps (measured), and steps grow with n as
they were seen to. Memory is that of the largest problem, on more ranks than one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

# A product with AIJ reads 8 bytes of value and 4 of index for every 2 flops.
BYTES_PER_FLOP = 6.0
# Pieces of a body in space: faces, edges and corners of a cube.
NEIGHBOURS = 26
# What each rank holds of each contact of all ranks, counted from the code: point, face, number, owner, rows, name.
BYTES_PER_CONTACT = 500.0
# A mesh that rank 0 reads from a file: coordinates, hexahedra and their numbers, while it deals them out, twice.
BYTES_PER_UNKNOWN_OF_FILE = 2 * (3 * 8 + 8 + 8 * 8 + 8) / 3
# What PETSc counts with 32 bits: unknowns of all ranks, nonzeros of one.
INDEX = 2**31 - 1
SIZES = (10**7, 10**8, 10**9)
NODES = (10, 100, 1000)


@dataclass(frozen=True)
class Node:
    """An assumed machine; all ranks of a node share its bandwidths."""

    cores: int = 64  # one rank each
    memory: float = 256e9  # bytes
    bandwidth: float = 200e9  # bytes a second
    latency: float = 2e-6  # seconds a message
    network: float = 12.5e9  # bytes a second


@dataclass(frozen=True)
class Measured:
    """What the model takes from the measurements."""

    flops: float  # an unknown and a step
    messages: float  # a neighbour and a step
    surface: float  # bytes a neighbour and a step over N^(2/3)
    meetings: float  # of all ranks in a step
    steps: float  # of the linear problem
    steps_size: float  # where they were counted
    growth: float  # steps ~ n^growth
    set_up: float  # of the multigrid, in steps
    contact: float  # seconds over those of the linear problem
    memory: float  # bytes an unknown
    empty: float  # bytes a rank before anything is built
    nonzeros: float  # an unknown
    contacts: float  # over n^(2/3)


def measured(found: Mapping[str, Any]) -> Measured:
    """From what `python -m benchmarks.scaling` writes."""
    strong, weak = ({run["ranks"]: run for run in found[name]} for name in ("strong", "weak"))
    one, two = strong[1], strong[2]
    n = one["unknowns"]
    steps = [
        (run["unknowns"], _first(run)["steps"]) for run in (weak[1], max(weak.values(), key=lambda r: r["unknowns"]))
    ]
    (n0, s0), (n1, s1) = steps
    linear = _first(one)
    per_step = linear["solve"] / linear["steps"]
    mine = _first(two)["per_step"]["KSPSolve"]
    big = max(found.get("large") or found["strong"], key=lambda run: run["ranks"])
    return Measured(
        flops=linear["per_step"]["KSPSolve"]["flops"][0] / n,
        messages=max(mine["numMessages"]) / 2,  # PETSc counts a message where it is sent and where it comes
        surface=max(mine["messageLength"]) / 2 / (n / 2) ** (2 / 3),
        meetings=two["contact"][0]["meetings_per_step"],
        steps=s1,
        steps_size=n1,
        growth=max(0.0, math.log(s1 / s0) / math.log(n1 / n0)),
        set_up=linear["set_up"] / per_step,
        contact=processor_ratio(two),  # PETSc makes its own levels faster on several ranks than on one
        memory=(sum(big["contact_peak"]) - sum(big["empty_peak"])) * 2**20 / big["unknowns"],
        empty=big["empty_peak"][0] * 2**20,
        nonzeros=one["nonzeros"] / n,
        contacts=one["contacts"] / n ** (2 / 3),
    )


def _first(run: Mapping[str, Any]) -> Any:
    return run["linear"][0]


def run_ratio(run: Mapping[str, Any], build: float = 0.0) -> float:
    """Contact with its certificate over the linear problem, set-up and solution both; the median of the rounds.

    `build` are the seconds that both take for mesh, elements and K, where they shall count.
    """
    return _median_ratio(run, ("set_up", "active_set", "certificate"), ("set_up", "solve"), build)


def same_multigrid_ratio(run: Mapping[str, Any], build: float = 0.0) -> float:
    """The same over the linear problem with the multigrid that contact has; the median of the rounds."""
    ratios = []
    for contact in run["contact"]:
        prepared = build + contact["set_up"]
        solved = contact["active_set"] + contact["certificate"]
        ratios.append((prepared + solved) / (prepared + contact["same_multigrid"]["solve"]))
    return sorted(ratios)[len(ratios) // 2]


def processor_ratio(run: Mapping[str, Any]) -> float:
    """The same of the seconds of processors, which other work on the machine changes little."""
    return _median_ratio(run, ("processor",), ("processor",))


def _median_ratio(
    run: Mapping[str, Any], of_contact: tuple[str, ...], of_linear: tuple[str, ...], both: float = 0.0
) -> float:
    ratios = sorted(
        (both + sum(contact[name] for name in of_contact)) / (both + sum(linear[name] for name in of_linear))
        for contact, linear in zip(run["contact"], run["linear"], strict=True)
    )
    return float(ratios[len(ratios) // 2])


@dataclass(frozen=True)
class Forecast:
    """One problem on so many nodes."""

    unknowns: int
    nodes: int
    per_rank: float  # unknowns
    memory: float  # bytes a node
    step: float  # seconds
    communication: float  # of these, all that is not reading memory
    steps: float
    linear: float  # seconds, set-up and solution
    contact: float  # seconds
    surface: float  # bytes a node, of contact surfaces that every rank has
    file: float  # bytes on rank 0 for a mesh from a file
    breaks: tuple[str, ...]


def forecast(unknowns: int, nodes: int, of: Measured, node: Node = Node()) -> Forecast:
    """What the model says."""
    ranks = nodes * node.cores
    here = unknowns / ranks
    neighbours = min(NEIGHBOURS, ranks - 1)
    reading = BYTES_PER_FLOP * of.flops * here / (node.bandwidth / node.cores)
    sending = neighbours * (of.messages * node.latency + of.surface * here ** (2 / 3) / (node.network / node.cores))
    meeting = of.meetings * 2 * math.log2(ranks) * node.latency
    step = reading + sending + meeting
    steps = of.steps * max(1.0, unknowns / of.steps_size) ** of.growth
    linear = (steps + of.set_up) * step
    contacts = of.contacts * unknowns ** (2 / 3)
    surface = node.cores * BYTES_PER_CONTACT * contacts
    memory = node.cores * of.empty + of.memory * unknowns / nodes + surface
    file = BYTES_PER_UNKNOWN_OF_FILE * unknowns
    room = node.memory - node.cores * of.empty
    limits = (
        (memory > node.memory, "memory"),
        (file > room, "a mesh file, read by rank 0"),
        (of.nonzeros * here > INDEX, "32-bit indices (nonzeros of a rank)"),
        (unknowns > INDEX, "32-bit indices (unknowns)"),
        (sending + meeting > reading, "messages take longer than numbers"),
    )
    return Forecast(
        unknowns=unknowns,
        nodes=nodes,
        per_rank=here,
        memory=memory,
        step=step,
        communication=sending + meeting,
        steps=steps,
        linear=linear,
        contact=of.contact * linear,
        surface=surface,
        file=file,
        breaks=tuple(name for over, name in limits if over),
    )


def forecasts(of: Measured) -> Iterator[Forecast]:
    """Every size on every number of nodes."""
    for unknowns in SIZES:
        for nodes in NODES:
            yield forecast(unknowns, nodes, of)
