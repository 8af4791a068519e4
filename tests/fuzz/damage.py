"""Ways in which a file may be wrong: other bytes, and tables that are not what they were."""

from __future__ import annotations

import copy
import datetime
from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st

Draw = Callable[[st.SearchStrategy[Any]], Any]

_DEEP: Any = 1.0
for _ in range(150):
    _DEEP = [_DEEP]

NASTY = (
    0, 1, -1, 0.0, -0.0, 1.0, -1.0, 0.5, 2, 3, 64, 5e-324, 1e-300, 1e-9, 1e9, 1e18, 1e300, -1e300,
    float("inf"), float("-inf"), float("nan"), 2**31, 2**63 - 1, -(2**63), 2**70, True, False,
    "", "x", "\0", "x" * 5000, "ä\n'\"", "../../../etc/passwd", "/dev/zero", "/", "nan", "auto",
    [], [[]], {}, {"a": {}}, [1.0], [1e300, 1e300], [0.1, 0.2, 0.3], [float("nan")] * 2, [1, "x"],
    ["x", "x"], [{}], [0.0] * 2000, _DEEP, datetime.date(2026, 1, 1), "°" * 40,
)  # fmt: skip
"""Values that somebody forgot to think of."""

WORDS = (
    "sine", "hold", "multisine", "waypoints", "csv", "paper1", "paper2", "pd_gravity", "paper",
    "computed_torque", "momentum", "eso", "adaptive", "oracle", "frozen", "measured", "tabulated",
    "mit", "moteus", "cia402", "off", "pace", "allow", "catch_up", "stop", "lugre", "rbf", "adapt",
    "hypotheses", "always", "gradient", "rls", "printed", "ramp", "total", "bias", "saturation",
    "dead_zone", "stuck_torque", "lag", "lock", "silent", "sensor_frozen", "sensor_noise", "can0",
    "joint2", "pendulums", "can1", "shoulder", "vcan", "inprocess",
)  # fmt: skip
"""Names that mean something somewhere."""


def _numbers(old: float) -> st.SearchStrategy[Any]:
    """Numbers beside a number: of its kind, of its sign, larger or smaller."""
    scaled = st.integers(-20, 20).map(lambda k: _scaled(old, k))
    return scaled | st.floats(allow_nan=False, allow_infinity=False) | st.integers(-3, 300)


def _scaled(old: float, power: int) -> float:
    return old * 10**power if power >= 0 or isinstance(old, float) else old // 10**-power


def _places(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place in a nested table below its root."""
    found = [path] if path else []
    items: Any = ()
    if isinstance(node, dict):
        items = node.items()
    elif isinstance(node, list):
        items = enumerate(node)
    for key, value in items:
        found += _places(value, (*path, key))
    return found


@st.composite
def altered(draw: Draw, table: dict[str, Any], most: int = 2) -> dict[str, Any]:
    """The table with changes: values replaced, scaled, removed, doubled or added."""
    result = copy.deepcopy(table)
    for _ in range(draw(st.integers(1, most))):
        places = _places(result)
        if not places:
            break
        *way, last = draw(st.sampled_from(places))
        node: Any = result
        for step in way:
            node = node[step]
        old = node[last]
        how = draw(st.integers(0, 14))
        number = isinstance(old, int | float) and not isinstance(old, bool)
        if how >= 10 and number:
            node[last] = draw(_numbers(old))
        elif how >= 10 and isinstance(old, str):
            node[last] = draw(st.sampled_from(WORDS))
        elif how <= 6 or how >= 10:
            node[last] = copy.deepcopy(draw(st.sampled_from(NASTY)))
        elif how == 7:
            del node[last]
        elif how == 8 and isinstance(node, list):
            node.append(copy.deepcopy(old))
        elif isinstance(node, dict):
            node[draw(st.text(max_size=8))] = copy.deepcopy(draw(st.sampled_from(NASTY)))
        else:
            node[last] = [old]
    return result


@st.composite
def damaged(draw: Draw, data: bytes, most: int = 6) -> bytes:
    """The bytes with changes: flipped, overwritten, cut out, repeated or cut off."""
    result = bytearray(data)
    for _ in range(draw(st.integers(1, most))):
        if not result:
            break
        at = draw(st.integers(0, len(result) - 1))
        how = draw(st.integers(0, 6))
        if how == 0:
            result[at] ^= 1 << draw(st.integers(0, 7))
        elif how == 1:
            result[at] = draw(st.sampled_from((0, 1, 0x7F, 0x80, 0xFF, 0x22, 0x3C, 0x3E)))
        elif how == 2:
            result[at:at] = draw(st.binary(min_size=1, max_size=16))
        elif how == 3:
            del result[at : at + draw(st.integers(1, 64))]
        elif how == 4:
            result[at : at + 8] = draw(
                st.sampled_from((b"\xff" * 8, bytes(8), b"\xff" * 7 + b"\x7f"))
            )
        elif how == 5:
            result[at:at] = result[at : at + draw(st.integers(1, 256))]
        else:
            del result[at:]
    return bytes(result)
