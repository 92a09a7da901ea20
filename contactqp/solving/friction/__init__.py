"""Coulomb friction: l_N >= 0, |l_T| <= mu l_N, l_T = mu l_N s/|s| where the slip s does not vanish.

This law is not the optimality condition of a minimisation, as the friction bound mu l_N depends on the answer. There is
one file for each algorithm. On the condensed unknowns of a contact problem in the plane, `tresca` repeats a
minimisation with the friction bound of the step before, `newton` solves for one combination of open, stick and slip
after another, and `enumeration` tries all of them. On the forces of a local problem (`local_form`; `contact_form` makes
one of a contact problem), in the plane and in space: `alart_curnier`, `gauss_seidel`, `admm`, and the fixed points over
`convex_steps`; `algorithms` lists and runs them. All end by solving the linear system of their combination to the last
digits (`contactqp.linalg.friction_states`). `associated` is the convex relaxation, a different law;
`contactqp.solving.methods.penalty` states the penalty method as an exact problem for these algorithms.
"""
