"""Settings are checked strictly, and documented."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.control import settings
from dftc_rt.errors import InputError

NOTATION = Path(__file__).parents[3] / "docs" / "notation.md"


def test_defaults_and_printed_values() -> None:
    ours = settings.parse({}, 3, printed=False)
    paper = settings.parse({}, 3, printed=True)
    assert paper.values["lam"].tolist() == [5.0] * 3
    assert paper.values["k"].tolist() == [10.0] * 3
    assert paper.values["layer"].tolist() == [0.0] * 3
    assert paper.values["gamma_rho"].tolist() == [2000.0] * 3
    assert paper.values["delta_max"].tolist() == [math.inf] * 3
    assert ours.values["layer"].min() > 0.0


def test_scalar_list_and_choice() -> None:
    got = settings.parse({"k": [1, 2.0], "lam": 7, "observer": "gradient"}, 2, printed=False)
    assert got.values["k"].tolist() == [1.0, 2.0]
    assert got.values["lam"].tolist() == [7.0, 7.0]
    assert got.values["observer"].tolist() == [1, 1]
    assert settings.parse({"observer": ["kalman", "gradient"]}, 2, printed=False).values[
        "observer"
    ].tolist() == [0, 1]


def test_weights_take_three_shapes() -> None:
    for value in (1.0, [1.0, 2.0], [[1.0, 2.0]] * 3):
        assert "w_f" in settings.parse({"w_f": value}, 3, printed=False).weights


@pytest.mark.parametrize(
    ("gains", "where"),
    [
        ({"kk": 1.0}, "control.gains.kk"),
        ({"k": -1.0}, "control.gains.k"),
        ({"k": [1.0, 2.0, 3.0]}, "control.gains.k"),
        ({"k": "fast"}, "control.gains.k"),
        ({"k": True}, "control.gains.k"),
        ({"k": math.nan}, "control.gains.k"),
        ({"observer": "magic"}, "control.gains.observer"),
        ({"grid_q": 2.5}, "control.gains.grid_q"),
        ({"w_f": ["a"]}, "control.gains.w_f"),
        ({"w_f": [math.inf]}, "control.gains.w_f"),
    ],
)
def test_wrong_input_is_refused_with_its_key(gains: dict, where: str) -> None:  # type: ignore[type-arg]
    with pytest.raises(InputError) as caught:
        settings.parse(gains, 2, printed=False)
    assert caught.value.where == where


def test_unknown_key_names_the_nearest_ones() -> None:
    with pytest.raises(InputError, match=r"unknown key .expected 'gamma_delta' or"):
        settings.parse({"gama_delta": 1.0}, 2, printed=False)


def test_every_setting_is_in_the_notation_with_its_values() -> None:
    rows = {}
    for line in NOTATION.read_text(encoding="utf-8").splitlines():
        if found := re.match(r"\| `(\w+)` \| ([^|]+) \| ([^|]+) \|", line):
            rows[found[1]] = (found[2].strip(), found[3].strip())
    for setting in settings.NUMBERS + settings.CHOICES + settings.SHAPE:
        shown = tuple(
            setting.choices[int(v)] if setting.choices else f"{v:g}"
            for v in (setting.default, setting.printed)
        )
        assert rows.get(setting.name) == shown, setting.name
    assert set(settings.WEIGHTS) <= set(rows)


def test_printed_values_lie_within_the_bounds() -> None:
    for setting in settings.NUMBERS + settings.CHOICES + settings.SHAPE:
        for value in (setting.default, setting.printed):
            assert setting.low <= value <= setting.high, setting.name
        assert np.isfinite(setting.default), setting.name
