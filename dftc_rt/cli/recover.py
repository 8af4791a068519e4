"""``dftc recover``: a torn log made whole."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from dftc_rt.log import recover as torn


def recover(log: str | Path, *, output: Annotated[str | Path, Parameter(alias="-o")]) -> int:
    """Save everything in a log that precedes its tear.

    Example::

        dftc recover torn.mcap -o whole.mcap

    Args:
        log: The log whose writer was cut off.
        output: The log to write.

    Returns:
        Exit code.

    Raises:
        LogError: The log cannot be read, or the output not be written.
    """
    saved = torn.recover(log, output)
    state = "it was whole" if saved.whole else "up to the tear"
    if saved.damaged:
        state = f"damaged and left out: {', '.join(saved.damaged)}"
    sys.stdout.write(
        f"{output}: {saved.messages} messages, {saved.attachments} attachments, "
        f"{saved.metadata} metadata records ({state})\n"
    )
    return 0
