"""Several scripts of this folder one after the other on the same ranks, which start once.

Arguments: scripts, each in one word with arguments of its own. A line ``--- NUMBER`` stands before what each says.
"""

import runpy
import shlex
import sys
from pathlib import Path

from contactqp.distributed.ranks import Ranks

ranks = Ranks()
for number, words in enumerate(sys.argv[1:]):
    name, *arguments = shlex.split(words)
    ranks.comm.barrier()
    if ranks.rank == 0:
        print(f"--- {number}", flush=True)
    script = Path(__file__).parent / name
    sys.argv[:] = [str(script), *arguments]
    runpy.run_path(str(script), run_name="__main__")
