"""The lines of a text file that another program printed, one after the other: files may be larger than memory."""

from __future__ import annotations

from collections.abc import Iterator

from contactqp.exchange.refusal import Path, file_size, wrong

# Programs that print tables of numbers break their lines; what does not is none of their files.
LONGEST = 2**16


def text_lines(path: Path, expected: str) -> Iterator[str]:
    """The lines, without their ends.

    Raises
    ------
    InvalidProblem
        No such file, an empty one, a byte that is not ASCII or zero, an endless line, or a last line that does not
        end: such a file was cut off, maybe within a number.
    """
    if not file_size(path, expected):
        raise wrong(path, "content", expected, "nothing")
    number = 0
    with open(path, "rb") as file:
        while line := file.readline(LONGEST):
            number += 1
            if not line.endswith(b"\n"):
                if len(line) == LONGEST:
                    raise wrong(path, f"line {number}", f"at most {LONGEST} bytes", "more")
                raise wrong(path, "last line", "a line break after it", "the end of the file: it was cut off")
            if not line.isascii() or b"\0" in line:
                strange = next(byte for byte in line if byte > 127 or byte == 0)
                raise wrong(path, f"line {number}", expected, f"the byte 0x{strange:02x}")
            yield line.rstrip(b"\r\n").decode("ascii")
