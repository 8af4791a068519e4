"""Compiled kernels belong to one revision of the sources."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import dftc_rt

PACKAGE = Path(dftc_rt.__file__).parent
SHOW = "import os, dftc_rt; print(os.environ['NUMBA_CACHE_DIR'], dftc_rt.__file__)"


def _cache(root: Path, **environment: str) -> Path:
    kept = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    given = {**kept, **environment, "PYTHONPATH": str(root)}
    command = [sys.executable, "-c", SHOW]
    out = subprocess.run(command, cwd=root, env=given, capture_output=True, text=True, check=True)
    place, file = out.stdout.split()
    assert Path(file).is_relative_to(root)
    return Path(place)


def _copy(root: Path) -> Path:
    (root / "dftc_rt").mkdir()
    (root / "hil").mkdir()
    for name in ("__init__.py", "errors.py"):
        shutil.copy(PACKAGE / name, root / "dftc_rt" / name)
    return root


def test_an_edit_anywhere_gives_another_folder(tmp_path: Path) -> None:
    root = _copy(tmp_path)
    before = _cache(root)
    assert before.is_relative_to(root / "dftc_rt")
    assert _cache(root) == before
    (root / "hil" / "plant.py").write_text("A = 1\n")
    assert _cache(root) != before


def test_old_revisions_are_forgotten(tmp_path: Path) -> None:
    root = _copy(tmp_path)
    places = []
    for number in range(8):
        (root / "hil" / "plant.py").write_text(f"A = {number}\n")
        places.append(_cache(root))
    assert not places[0].exists()
    assert places[-1].is_dir()
    assert len(list(places[-1].parent.glob("numba-*"))) <= 4


def test_a_folder_of_the_users_is_taken(tmp_path: Path) -> None:
    root = _copy(tmp_path)
    mine = tmp_path / "mine"
    found = _cache(root, NUMBA_CACHE_DIR=str(mine))
    assert found.parent == mine
    assert _cache(root, NUMBA_CACHE_DIR=str(found)) == found  # of a parent process
