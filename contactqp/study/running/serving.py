"""The other end of a `Child`: a process that runs one function after the other as it is told."""

from __future__ import annotations

import os
import pickle
import queue
import signal
import sys
import threading
from typing import Any, BinaryIO


def serve() -> None:
    """Run what comes on stdin, and send what it gives to where stdout was; what libraries print goes to stderr.

    Ctrl-C is for the parent. Where that is gone, be it killed, nothing comes from it any more, and this process leaves
    in the middle of what it does.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    orders: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_receive, args=(sys.stdin.buffer, orders), daemon=True).start()
    while True:
        replies.write(_reply(orders.get()))
        replies.flush()


def _receive(stream: BinaryIO, orders: queue.Queue[bytes]) -> None:
    while size := stream.read(8):
        orders.put(stream.read(int.from_bytes(size, "big")))
    os._exit(0)


def framed(data: bytes) -> bytes:
    """A message as it is sent: its size first."""
    return len(data).to_bytes(8, "big") + data


def _reply(order: bytes) -> bytes:
    try:
        function, arguments = pickle.loads(order)
        return framed(pickle.dumps((True, function(*arguments))))
    except Exception as error:  # noqa: BLE001  it is raised in the parent
        return framed(pickle.dumps((False, _portable(error))))


def _portable(error: Exception) -> Any:
    """An error that arrives: some that carry more than words cannot be made again."""
    try:
        return pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001  whatever it is that does not travel
        return RuntimeError(f"{type(error).__name__}: {error}")
