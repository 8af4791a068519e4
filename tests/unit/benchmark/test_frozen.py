"""What is frozen stays as it is."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from dftc_rt.benchmark import frozen, sources
from dftc_rt.benchmark.frozen import Frozen
from dftc_rt.errors import InputError, MissingFileError

FOUND = frozen.stamped(
    Frozen(
        when="2026-01-01 00:00 UTC", momentum_threshold=2.378, dftc_alarms=1, dftc_hours=2.5,
        momentum_alarms=1, momentum_hours=2.5, fingerprints={"ur5": "abc", "panda": "def"},
    )
)  # fmt: skip


def test_it_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "frozen.toml"
    frozen.write(FOUND, path)
    assert frozen.load(path) == FOUND


def test_the_hash_is_of_everything_but_the_time() -> None:
    later = msgspec.structs.replace(FOUND, when="later")
    other = msgspec.structs.replace(FOUND, momentum_threshold=2.0)
    assert frozen.stamped(later).settings == FOUND.settings
    assert frozen.stamped(other).settings != FOUND.settings


def test_a_change_by_hand_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "frozen.toml"
    frozen.write(FOUND, path)
    path.write_text(path.read_text().replace("2.378", "2.0"))
    with pytest.raises(InputError, match="settings: is not the hash"):
        frozen.load(path)


def test_without_it_the_line_says_how_to_make_it(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="--freeze"):
        frozen.load(tmp_path / "frozen.toml")


def test_other_sources_are_refused() -> None:
    frozen.check(FOUND, {"ur5": "abc"}, "frozen.toml")
    with pytest.raises(InputError, match=r"frozen\.toml: panda: frozen with def, now xyz"):
        frozen.check(FOUND, {"ur5": "abc", "panda": "xyz"}, "frozen.toml")
    with pytest.raises(InputError, match="xarm7: frozen with nothing"):
        frozen.check(FOUND, {"xarm7": "abc"}, "frozen.toml")


def test_a_digest_tells_names_and_contents_apart() -> None:
    first = sources.digest([("a", b"xy"), ("b", b"")])
    assert first == sources.digest([("b", b""), ("a", b"xy")])
    assert first != sources.digest([("a", b"x"), ("b", b"y")])
    assert first != sources.digest([("ax", b"y"), ("b", b"")])


def test_only_what_matches_is_read(tmp_path: Path) -> None:
    (tmp_path / "dftc_rt" / "control" / "baselines").mkdir(parents=True)
    for name in ("control/kernel.py", "control/baselines/eso.py", "control/notes.txt"):
        (tmp_path / "dftc_rt" / name).write_text(name)
    found = dict(sources.read_all(tmp_path, sources.ROWS))
    assert set(found) == {"dftc_rt/control/kernel.py", "dftc_rt/control/baselines/eso.py"}


def test_how_rows_are_shown_decides_no_row() -> None:
    root = Path(sources.__file__).parents[2]
    names = {name for name, _ in sources.read_all(root, sources.ROWS)}
    assert {"dftc_rt/control/kernel.py", "hil/rig.py", "robots/ur5/robot.toml"} <= names
    assert {"dftc_rt/benchmark/measure.py", "dftc_rt/cli/benchmark_runs.py"} <= names
    assert not names & {"dftc_rt/benchmark/tables_laws.py", "dftc_rt/benchmark/page.py"}
