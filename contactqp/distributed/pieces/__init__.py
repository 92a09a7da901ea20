"""One process's piece of meshed bodies: its elements, the nodes they use, and its rows of the stiffness.

sources      a shape or a file, of which each rank first takes an equal share of the elements
facets       which elements share a facet, on whatever ranks: the graph that is cut, and the boundary
dealing      elements go to the ranks that the partitioner says
nodes        who owns a node, its number in the whole mesh and in PETSc's order
mesh_piece   the elements of one rank as a Mesh
stiffness    K, of which no rank has more than its rows
touching     the surfaces that may touch, which all ranks have
"""
