"""One block on a rigid floor, solved by other codes, every answer judged by `contactqp check`."""
