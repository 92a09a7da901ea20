"""pytester runs the scratch projects of the tests of our pytest plugin; BLAS has one thread.

Several processes run tests at once, and threads of BLAS that wait for a core cost the others theirs. Said before NumPy
is imported; whoever sets the variable is obeyed.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

pytest_plugins = ["pytester"]
