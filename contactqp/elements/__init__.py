"""Members, solids and membranes, their meshes and loads, and the rows and gaps of sides that can touch.

Exact numbers (`fractions.Fraction`) in give exact numbers out wherever the formula is rational; floats give floats.
Every stiffness is K_e in K_e u_e = f_e with the element's unknowns node by node.
"""
