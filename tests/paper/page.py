"""docs/paper.md from what ``dftc paper`` wrote.

dftc paper -o build/paper && python -m tests.paper.page build/paper
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any, Final

from dftc_rt.paper import summary

REPOSITORY: Final = Path(__file__).parents[2]
PAGE: Final = REPOSITORY / "docs" / "paper.md"
IMAGES: Final = REPOSITORY / "docs" / "images" / "paper"

_HEAD: Final = """# What of the paper reproduces

Figures and numbers of this page are what this command wrote, and a test compares the numbers
with those of a fresh run (`tests/paper/test_summary.py`):

```sh
dftc paper -o build/paper
```

Beside them it writes the curves as CSV and SVG. `--gain`, `--robust`, `--identifier` and
`--epsilon` draw another variant; `--search` adds what came of trying other readings of the
equations, and `--discrete` what the printed law needs to run at a fixed rate
([contract](contract.md#figures-of-the-paper)).
The equations are in [theory](theory.md).

"""


def page(found: dict[str, Any]) -> str:
    """Return the page that belongs to a ``summary.json``."""
    return _HEAD + summary.markdown(found, {}).replace("](figure", "](images/paper/figure")


def main(folder: Path) -> None:
    """Renew the page and its pictures from a folder that ``dftc paper`` wrote."""
    found = json.loads((folder / "summary.json").read_text("utf-8"))
    PAGE.write_text(page(found), "utf-8")
    IMAGES.mkdir(parents=True, exist_ok=True)
    for picture in folder.glob("figure*.png"):
        shutil.copyfile(picture, IMAGES / picture.name)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
