"""Write a page for every public module of both packages, from its docstrings."""

from pathlib import Path

import mkdocs_gen_files

ROOT = Path(__file__).parents[2]
nav = mkdocs_gen_files.Nav()

for package in ("dftc_rt", "hil"):
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[-1] == "__init__":
            parts = parts[:-1]
            page = Path("reference", *parts, "index.md")
        else:
            page = Path("reference", *parts).with_suffix(".md")
        nav[parts] = page.relative_to("reference").as_posix()
        with mkdocs_gen_files.open(page, "w") as file:
            print(f"# {parts[-1]}\n\n::: {'.'.join(parts)}", file=file)
        mkdocs_gen_files.set_edit_path(page, path.relative_to(ROOT))

with mkdocs_gen_files.open("reference/SUMMARY.md", "w") as file:
    file.writelines(nav.build_literate_nav())
