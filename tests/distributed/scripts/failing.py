"""The command line, on ranks of which one fails in the middle: failing.py KIND RANK ARGUMENTS..."""

from __future__ import annotations

import os
import resource
import signal
import sys

import numpy as np

import contactqp.distributed.running_on_ranks as running
from contactqp.cli import main
from contactqp.distributed.ranks import Ranks, petsc
from contactqp.errors import NoEquilibrium

# Bytes that a rank may still take, and more than that.
LEFT, MORE = 2**26, 2**28


def bug():
    """What nobody has thought of."""
    return {}["nothing"]


def petsc_error():
    """PETSc refuses, here alone."""
    PETSc = petsc()
    PETSc.Mat().create(PETSc.COMM_SELF).setType("no such type")


def memory():
    """The machine of this rank has no more of it."""
    with open("/proc/self/statm") as file:
        taken = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + LEFT, taken + LEFT))
    np.ones(MORE // 8)


def killed():
    """By the system, say, which needed its memory."""
    os.kill(os.getpid(), signal.SIGKILL)


def refused():
    """An error of contactqp's own that is not agreed on."""
    raise NoEquilibrium("this rank alone sees no equilibrium")


KINDS = {found.__name__: found for found in (bug, petsc_error, memory, killed, refused)}
kind, failing = sys.argv[1], int(sys.argv[2])
here = Ranks().rank == failing
if kind == "no_file":
    if here:
        os.chdir("/")
elif kind != "nothing":
    distribute = running.distribute

    def fails(*arguments):
        if here:
            KINDS[kind]()
        return distribute(*arguments)

    running.distribute = fails
main(sys.argv[3:])
