"""Stands for the process that measures, and comes to no good end."""

import os
import signal
import sys

if __name__ == "__main__":
    if sys.argv[1] == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if sys.argv[1] == "raise":
        raise ValueError("no such luck")
    print("a library says hello")
