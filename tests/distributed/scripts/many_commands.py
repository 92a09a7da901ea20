"""Several commands of the command line in one process: many_commands.py JSON, a list of lists of arguments.

Prints JSON: of each its exit code, standard output and standard error.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys

from contactqp.cli import main

done = []
for arguments in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    code = None
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(arguments)
        except SystemExit as end:
            code = end.code
    done.append((code, out.getvalue(), err.getvalue()))
print(json.dumps(done))
