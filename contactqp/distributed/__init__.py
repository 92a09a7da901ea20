"""One contact problem over the processes (ranks) of MPI: PETSc holds K and knows its inverse, the rest is here.

Every rank holds the rows of K of the nodes that are its own, the contacts of these nodes, and nothing whole. What a
function here takes and returns is the part of its rank, unless it says otherwise; functions that have to be called by
all ranks together are called collective.
"""
