"""The piece of meshed bodies that one process has: its elements, the nodes they use, and its rows of the stiffness.

partition_mesh  shares of the elements of shapes and files, the cut of their graph, the elements of one rank as a mesh
nodes           owners and numbers of nodes, the distributed stiffness, the surfaces that may touch
system          supports and loads on the pieces, and the contact problem that they make
"""
