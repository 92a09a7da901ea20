"""Coulomb friction in the plane: l_N >= 0, |l_T| <= mu l_N, l_T = mu l_N s/|s| where the slip s does not vanish.

No minimisation has this law for its optimality conditions: the friction bound mu l_N is part of the answer. One file an
algorithm: `tresca` minimises again and again with the bound of the step before, `enumeration` tries every combination
of open, stick and slip. Both end with the linear system of their combination, solved to the last digits (`states`).
`contact_springs` makes of the penalty method an exact problem for them.
"""
