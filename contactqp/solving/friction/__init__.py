"""Coulomb friction: l_N >= 0, |l_T| <= mu l_N, l_T = mu l_N s/|s| where the slip s does not vanish.

No minimisation has this law for its optimality conditions: the friction bound mu l_N is part of the answer. One file an
algorithm. On the condensed unknowns of a contact problem in the plane, `tresca` minimises again and again with the
bound of the step before, `newton` goes from one combination of open, stick and slip to the next that its answer
suggests, `enumeration` tries every one. On the forces of a local problem (`local_form`; `contact_form` makes one of a
contact problem), in the plane and in space: `alart_curnier`, `gauss_seidel`, `admm`, and the fixed points over
`convex_steps`; `algorithms` lists and runs them. All end with the linear system of their combination, solved to the
last digits (`contactqp.linalg.friction_states`). `associated` is the convex relaxation, which is another law;
`contactqp.solving.methods.penalty` makes of the penalty method an exact problem for all of these.
"""
