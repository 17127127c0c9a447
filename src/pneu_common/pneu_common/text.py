# SPDX-License-Identifier: Apache-2.0
"""Text from outside, made fit for logs, terminals and files."""


def one_line(text: object, longest: int = 2000) -> str:
    """Return a text as one line that any terminal, log and file can take.

    Line feeds and other white space become single spaces. Control and escape characters, halves of
    characters and other unprintable ones are written as in Python's literals, so that no name can
    forge a line or a colour. The middle of a long text is left out.

    Args:
        text: Text of any origin, or an object.
        longest: Greatest number of characters.
    """
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in " ".join(str(text).split()))
    if len(line) > longest:
        half = (longest - 5) // 2
        line = f"{line[:half]} ... {line[len(line) - half :]}"
    return line
