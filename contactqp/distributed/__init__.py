"""One contact problem over the processes (ranks) of MPI, with matrices and preconditioners of PETSc.

Every rank has the rows of K of its own nodes and the contacts of these nodes; none has the whole problem. Functions
take and return the part of their rank, unless stated otherwise. Functions that all ranks must call together are marked
"collective". Shapes with the index "here" (n_here, m_here, k_here) count unknowns, contacts and ties of one rank.

solving           the public functions, and the choice of the method
problem           the part of the problem and of its solution on one rank; distributing makes it from a whole problem
iteration         the active set by iteration, with preconditioner, smoothed_aggregation and floating (rigid motions)
bounded           PETSc's own solvers of problems with bounds, for comparison
certificate       the verdict on a distributed answer, from violations
partition_mesh    shares of the elements of shapes and files, the cut of their graph, the elements of one rank as a mesh
mesh_nodes        owners and numbers of nodes, the distributed stiffness, the surfaces that may touch
mesh_system       supports and loads on the pieces of a mesh, and the contact problem that they make
distributed_bodies, running_on_ranks   case files on ranks; checkpoint keeps the steps of a path
ranks             PETSc and MPI loaded, sums and messages of ranks; rows has the matrices of constraints
"""
