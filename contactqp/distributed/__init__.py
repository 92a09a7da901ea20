"""One contact problem over the processes (ranks) of MPI, with matrices and preconditioners of PETSc.

Every rank has the rows of K of its own nodes and the contacts of these nodes; none has the whole problem. Functions
take and return the part of their rank, unless they say otherwise; those that all ranks must call together are called
collective. Shapes with the index "here" (n_here, m_here, k_here) count unknowns, contacts and ties of one rank.
"""
